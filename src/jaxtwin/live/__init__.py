"""A live rig: links, protocol, recorder, drive, virtual rig, replay.

Bytes become records (`Sample`, `Reading`, ...), which are in the journal before anyone sees them.
The contract is in docs/reliability.md, what goes over the wire in docs/protocol.md.

The public names stand in `__init__.pyi` and are imported when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
