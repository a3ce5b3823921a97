"""Files and folders: their names, how they are written whole, what they are listed and known by."""
