"""What is wrong with the present frame or preset: one file for each check, in the order of `registry`."""
