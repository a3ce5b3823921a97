"""Edges by the method of Nevatia and Babu (1980): masks, thinning, linking, tracing."""
