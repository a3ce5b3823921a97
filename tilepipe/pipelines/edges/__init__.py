"""Edge lines from aerial photographs (Barbosa 1994), and Nevatia–Babu edges beside them.

Here stands what the command line shows of the pipeline without importing it.
"""

from __future__ import annotations

from tilepipe.engine.inputs import Input

SUMMARY = "Segmentation, line field and edge lines from aerial photographs, and Nevatia–Babu edges beside them."

INPUTS: tuple[Input, ...] = ()
