"""The documentation's site: `make docs` builds it into out/docs, warnings are errors."""

from html import escape

from docutils import nodes
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath, text_to_path

import wrod

project = "wrod"
author = "the founders of wrod"
version = release = wrod.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
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
html_show_copyright = False  # there is none to show but the licence's
html_math_renderer = "drawn"

# Of formulas: small letters as large as those of the text beside them, at 10 units an em.
_FONT = FontProperties(size=11, math_fontfamily="stix")
_COMMANDS = {1: "M", 2: "L", 3: "Q", 4: "C", 79: "Z"}


def _drawn(tex: str) -> str:
    """A formula as an SVG picture that stands on the line of the text around it: a page needs
    neither a network nor a script for it, and is printed as it is seen."""
    text = f"${' '.join(tex.split())}$"
    width, height, depth = text_to_path.get_text_width_height_descent(text, _FONT, ismath=True)
    outline = TextPath((0.0, 0.0), text, prop=_FONT).iter_segments(simplify=False)
    path = "".join(
        _COMMANDS[code] + ("" if code == 79 else " ".join(f"{x:.2f} {-y:.2f}" for x, y in points))
        for points, code in ((points.reshape(-1, 2), code) for points, code in outline)
    )
    said = escape(text[1:-1])
    return (
        f'<svg role="img" aria-label="{said}" viewBox="0 {depth - height:.2f} {width:.2f} '
        f'{height:.2f}" style="width: {width / 10:.3f}em; height: {height / 10:.3f}em; '
        f'vertical-align: {-depth / 10:.3f}em; overflow: visible"><title>{said}</title>'
        f'<path fill="currentColor" d="{path}"/></svg>'
    )


def _write_inline(translator, node) -> None:
    translator.body.append(_drawn(node.astext()))
    raise nodes.SkipNode


def _write_block(translator, node) -> None:
    style = "overflow-x: auto; text-align: center; padding: 0.5em 0"
    translator.body.append(f'<div style="{style}">{_drawn(node.astext())}</div>')
    raise nodes.SkipNode


def setup(app) -> None:
    """Called by Sphinx."""
    app.add_html_math_renderer("drawn", (_write_inline, None), (_write_block, None))
