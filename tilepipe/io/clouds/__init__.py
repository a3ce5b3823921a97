"""Point clouds: found, their headers checked, their points read."""
