# Public names of jaxtwin.twin_store. `__init__.py` imports each when it is first used.

from ._store import TwinStore as TwinStore
from ._version import AliasMove as AliasMove
from ._version import TwinVersion as TwinVersion
from ._version import VersionDiff as VersionDiff
