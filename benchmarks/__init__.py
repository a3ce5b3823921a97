"""Speed and quality beside what a user would pick instead, measured side by side on one machine.

``scripts/bench kernels`` compares the kernels and the engine, ``scripts/bench streets`` and ``scripts/bench objects``
the pipelines; the tables go to the terminal and, as Markdown, to ``benchmarks/results``.
"""
