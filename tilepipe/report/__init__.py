"""The toolkit for pictures and map pages of finished runs."""
