"""From pixels to a street graph: skeleton, tracing, fragments, cleaning."""
