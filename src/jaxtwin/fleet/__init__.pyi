# Public names of jaxtwin.fleet. `__init__.py` imports each when it is first used.

from ._app import fleet_app as fleet_app
from ._app import overview as overview
from ._fleet import Fleet as Fleet
from ._fleet_file import FleetFile as FleetFile
from ._fleet_file import Member as Member
from ._virtual_fleet import VirtualFleet as VirtualFleet
from ._virtual_fleet import virtual_fleet_process as virtual_fleet_process

__all__: list[str]
