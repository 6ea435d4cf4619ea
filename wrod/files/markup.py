"""XML that users hand over: bounded in size, depth and count, without entities that grow."""

import os
from xml.etree import ElementTree
from xml.parsers import expat

from wrod.errors import DataError, WrodError
from wrod.files.reading import MIB, read_bytes, shown

MAX_MARKUP = 16 * MIB
# Robots and drawings have thousands of elements.
MAX_ELEMENTS = 50_000
# Illustrator declares the addresses of its namespaces as entities.
_LONGEST_ENTITY = 200


class _Refused(Exception):
    """Ends the parser from within its callbacks; says why."""


def read_markup(
    path: str | os.PathLike[str],
    what: str,
    *,
    content: bytes | None = None,
    error: type[WrodError] = DataError,
    deepest: int = 24,
    entities: bool = False,
) -> ElementTree.Element:
    """Root of an XML file. Names keep their prefixes, which need not be declared: robots' files are
    written without.

    Args:
        path: the file.
        what: what it should be, for messages: "a URDF file".
        content: what the file expands to; default: what it holds.
        error: type of the refusal.
        deepest: most elements within each other.
        entities: let short entities without others in them be declared.

    Raises:
        WrodError: of type `error`: it cannot be read, is no XML, or is larger, deeper or has more
            elements than any file of its kind, or declares entities; names the line.
    """
    if content is None:
        content = read_bytes(path, what, error=error, limit=MAX_MARKUP)
    if not content.strip():
        raise error(f"{path}: is empty; give {what}")
    parser, builder = expat.ParserCreate(), ElementTree.TreeBuilder()
    _bound(parser, builder, deepest, entities)
    try:
        parser.Parse(content, True)
        return builder.close()
    except _Refused as reason:
        raise error(f"{path}, line {parser.CurrentLineNumber}: {reason}; give {what}") from None
    except (expat.ExpatError, ValueError, LookupError) as reason:
        raise error(
            f"{path}: not readable as XML ({shown(reason, 200)}); correct the file or give {what}"
        ) from None


def _bound(parser, builder: ElementTree.TreeBuilder, deepest: int, entities: bool) -> None:
    """Let the parser build the tree, and stop at what no file of ours has, before it costs
    anything."""
    depth = count = 0

    def start(name: str, attributes: dict) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > deepest or count > MAX_ELEMENTS:
            raise _Refused(
                f"has more than {MAX_ELEMENTS} elements, or more than {deepest} in each other"
            )
        builder.start(name, attributes)

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(name)

    def entity(name, parameter, value, base, system, public, notation) -> None:
        short = value is not None and "&" not in value and len(value) <= _LONGEST_ENTITY
        if not (entities and short) or parameter:
            raise _Refused(f"declares the XML entity {shown(name)}, which could stand for anything")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = builder.data
    parser.EntityDeclHandler = entity
