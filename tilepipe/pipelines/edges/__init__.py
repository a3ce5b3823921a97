"""Edge lines from aerial photographs (Barbosa 1994), and Nevatia–Babu edges beside them."""
