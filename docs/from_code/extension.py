"""Directives that put the parts which follow from the code on pages, and the pages of the kernels."""

from __future__ import annotations

import inspect
import os
import re
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from sphinx.util.parallel import make_chunks

from docs.from_code import columns, commands, kernels, parameters

_ARRAY = re.compile(r"~?(?:numpy\.)?ndarray\[tuple\[[^]]*\], ~?(?:numpy\.)?dtype\[([^]]*)\]\]")


class FromCode(SphinxDirective):
    """Puts a Markdown text on the page; its argument says of which pipeline or table."""

    optional_arguments = 1
    texts: ClassVar[dict[str, Any]] = {
        "parameter-table": lambda name: parameters.parameter_table(parameters.MODELS[name]),
        "column-table": columns.column_table,
        "exit-codes": commands.exit_code_table,
        "command-line": commands.command_sections,
    }

    def run(self) -> list[nodes.Node]:
        """See `docutils.parsers.rst.Directive.run`."""
        return self.parse_text_to_nodes(self.texts[self.name](*self.arguments), allow_section_headings=True)


def write_kernel_pages(app: Sphinx) -> None:
    """Write a page per package of kernels into ``reference/kernels``; pages that would be the same stay untouched."""
    folder = Path(app.srcdir) / "reference" / "kernels"
    folder.mkdir(exist_ok=True)
    packages = {package.__name__.rpartition(".")[2]: package for package in kernels.packages()}
    wanted = {f"{name}.rst": _kernel_page(package) for name, package in packages.items()}
    for path in folder.iterdir():
        if path.name not in wanted:
            os.unlink(path)
    for name, text in wanted.items():
        path = folder / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _kernel_page(package: Any) -> str:
    name = package.__name__
    parts = [_heading(name, "="), inspect.getdoc(package) or ""]
    for module in kernels.modules(package):
        parts += [_heading(module.__name__.removeprefix(f"{name}."), "-"), f".. automodule:: {module.__name__}"]
        parts += [_entry(module, kind, item) for kind, item in kernels.public(module)]
    return "\n\n".join(parts) + "\n"


def _entry(module: Any, kind: str, name: str) -> str:
    methods = kernels.methods(getattr(module, name)) if kind == "class" else []
    return f".. auto{kind}:: {name}" + (f"\n   :members: {', '.join(methods)}" if methods else "")


def shorten_arrays(*event: Any) -> tuple[str | None, str | None]:
    """Call arrays in signatures what the code calls them: ``NDArray[np.float32]``, not what that stands for."""
    signature, returned = event[-2:]
    return tuple(text and _ARRAY.sub(r"NDArray[\1]", text) for text in (signature, returned))  # type: ignore[return-value]


def deal_out(app: Sphinx, environment: Any, names: list[str]) -> None:
    """Let the pages that run be read first and by two processes, each of which takes a chunk of pages."""
    running = [name for name in names if name.startswith("tutorials/")]
    others = [name for name in names if name not in running]
    chunk, *_ = make_chunks(names, max(app.parallel, 1)) or [[]]
    gap = max(0, len(chunk) - len(running[::2]))
    names[:] = [*running[::2], *others[:gap], *running[1::2], *others[gap:]]


def _heading(text: str, line: str) -> str:
    return f"{text}\n{line * len(text)}"


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the directives."""
    for name in FromCode.texts:
        app.add_directive(name, FromCode)
    app.connect("builder-inited", write_kernel_pages)
    app.connect("env-before-read-docs", deal_out)
    app.connect("autodoc-process-signature", shorten_arrays)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
