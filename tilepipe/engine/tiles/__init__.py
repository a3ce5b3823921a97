"""How the tiles of a pass are computed: where they run, what they leave, and which are done."""
