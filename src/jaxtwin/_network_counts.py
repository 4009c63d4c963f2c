"""What a network amounts to, for reports and checks."""

from .physics import Netlist
from .rig import Rig


def network_counts(netlist: Netlist, rig: Rig) -> dict[str, float | int]:
    """Counts and sums of a network, with the values of the rig's own parameter table."""
    values = {name: row.to_si(row.value) for name, row in rig.parameters.items()}
    return {
        "states": len(netlist.nodes),
        "plate_nodes": sum(node.kind == "plate" for node in netlist.nodes),
        "plate_resistances": sum(link.role in ("conduction", "film") for link in netlist.links),
        "plate_capacitance_J_per_K": netlist.capacitance(values, "plate"),
        "plate_to_ambient_W_per_K": netlist.ambient_conductance(values, "plate"),
    }


def network_text(counts: dict[str, float | int]) -> str:
    """What there is of a network, in the words of all places that say it."""
    names = {"states": "state", "plate_nodes": "plate element", "plate_resistances": "resistance"}
    parts = [f"{counts[key]} {one}{'s' * (counts[key] != 1)}" for key, one in names.items()]
    return f"{', '.join(parts)} on the plate"
