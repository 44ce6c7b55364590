"""Logs of moving arms with joint torques: inverse dynamics, what the rigid model lacks, and how sure that is.

What others may use is named in ``__init__.pyi``; a module is imported when a name of it is first asked for.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
