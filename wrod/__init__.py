"""wrod plans and proves how a robot lays a rod along a pattern.

Public names are imported when first used, so that `import wrod` stays light; they are listed, with
their modules, in `__init__.pyi`, which editors and type checkers read.
"""

import lazy_loader

# The only place of it: the package, datasets and benchmarks read it here.
__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
