"""Commands and readings of a simulated arm's joints: the servo by output error, and what it lacks.

What others may use is named in ``__init__.pyi``; a module is imported when a name of it is first asked for.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
