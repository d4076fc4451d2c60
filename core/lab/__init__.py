"""What a paper needs and a robot does not: rival methods, their table, strain, truth from a scan, benchmark engines."""
