from ._app import fleet_app as fleet_app
from ._fleet import Fleet as Fleet
from ._fleet_file import FleetFile as FleetFile
from ._fleet_file import Member as Member
from ._overview import overview as overview
from ._virtual_fleet import VirtualFleet as VirtualFleet
from ._virtual_fleet import VirtualFleetProcess as VirtualFleetProcess

__all__: list[str]
