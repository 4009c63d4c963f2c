"""A live rig: links, protocol, recorder, drive, virtual rig, replay.

Bytes become records (`Sample`, `Reading`, ...), which are written to the recording (the journal)
before any other part of the program gets them. docs/reliability.md states the guarantees,
docs/protocol.md specifies the protocol.

The public names stand in `__init__.pyi` and are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
