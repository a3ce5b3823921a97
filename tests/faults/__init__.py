"""A simulator of faults: small runs whose files and tiles fail at any single point, and are then resumed."""
