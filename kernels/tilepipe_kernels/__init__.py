"""Array mathematics of tilepipe: blocks in, blocks out; no files, no coordinates, no scheduler."""
