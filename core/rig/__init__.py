"""What is measured of a rig: depth quality, delay, drift, the untouched membrane."""
