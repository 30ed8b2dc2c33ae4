"""Self-contained HTML pages with the figures of results.

The names in ``__init__.pyi`` are loaded on first use, so that a page loads no other rooms.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
