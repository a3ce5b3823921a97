"""``python -m tilepipe``."""

from tilepipe.cli import main

main()
