"""Speed and quality beside what a user would pick instead, measured side by side on one machine.

``scripts/bench kernels`` compares the kernels and the engine, ``scripts/bench streets``, ``objects`` and ``edges`` the
pipelines, and ``scripts/bench memory`` what runs take with what was planned for them; the tables go to the terminal
and, as Markdown, to ``benchmarks/results``.
"""
