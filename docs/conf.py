"""The documentation's site: `make docs` builds it into out/docs, warnings are errors."""

import wrod

project = "wrod"
author = "the founders of wrod"
version = release = wrod.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]

autodoc_member_order = "bysource"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autosummary_generate = True
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Warns", "params_style")]

html_theme = "furo"
html_title = f"wrod {release}"
# Formulas are written by the browser; where it has no network they stay readable as TeX.
