"""Pictures and map pages of finished runs."""
