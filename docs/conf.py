"""How Sphinx builds the documentation; `scripts/docs` calls it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "kernels")]
# Commands and notebooks that the pages run are to find the same sources, and the program beside the interpreter.
os.environ["PYTHONPATH"] = os.pathsep.join([*sys.path[:2], os.environ.get("PYTHONPATH", "")])
os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
# Pages run the same whatever the configuration of IPython is here; its kernels warn of nothing but errors.
IPYTHON = ROOT / "docs" / "_build" / "ipython"
os.environ["IPYTHONDIR"] = str(IPYTHON)
(IPYTHON / "profile_default").mkdir(parents=True, exist_ok=True)
(IPYTHON / "profile_default" / "ipython_kernel_config.py").write_text("c.IPKernelApp.log_level = 40\n")

import nbclient

import tilepipe

# What a command prints comes in pieces; they are put together as they are, before any page sees them.
nbclient.NotebookClient.coalesce_streams = True

project = "tilepipe"
author = "tilepipe authors"
project_copyright = "tilepipe authors, Apache License 2.0"
version = release = tilepipe.__version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "myst_nb",
    "sphinx_design",
    "docs.from_code.extension",
]
root_doc = "index"
exclude_patterns = ["from_code", "_build", "**/.ipynb_checkpoints"]
templates_path: list[str] = []

# Pages: MyST Markdown.  A page with code cells runs from top to bottom in each build, and an error ends the build.
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 900  # a first call compiles
nb_execution_raise_on_error = True
nb_merge_streams = True

# What a docstring quotes is linked where these pages have it.  Types of other libraries are not: their inventories
# lie in the network, which a build does not need.
default_role = "py:obj"
nitpicky = True
# type variables have no page
nitpick_ignore_regex = [("py:obj", ".*"), ("py:(class|data|exc)", r"(?!tilepipe).*|.*\.(Result|Some)")]
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
python_maximum_signature_line_length = 100
numpydoc_show_class_members = False
autosummary_generate = False

# Looked at only by `scripts/docs -b linkcheck`, where there is a network.
linkcheck_timeout = 20

html_theme = "pydata_sphinx_theme"
html_title = "tilepipe"
html_static_path = ["static"]
html_css_files = ["tilepipe.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "show_prev_next": True,
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}
