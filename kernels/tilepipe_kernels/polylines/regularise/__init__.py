"""Walls made straight and right-angled within one coverage."""
