"""The rig of a report and the thermal network that it becomes."""

from ..physics import Twin
from ..physics._netlist import network_counts
from ..plots import plot_netlist, to_png
from ._blocks import Numbers, Picture, Section, Text


def rig_section(
    twin: Twin, title: str, *, note: str = "", caption: str = "The thermal network of the rig."
) -> tuple[Section, dict[str, float | int]]:
    """The rig's description and its network.

    **Arguments:**

    - `twin`: a twin of the rig.
    - `title`: the title of the section.
    - `note`: a paragraph that follows the description.
    - `caption`: the caption of the picture.

    **Returns:** the section, and the network's numbers.
    """
    rig = twin.rig
    counts = network_counts(twin.netlist, rig)
    words = (" ".join(rig.description.split()) or rig.title, note)
    section = Section(
        title,
        (
            *(Text(paragraph) for paragraph in words if paragraph),
            Numbers(
                (
                    (f"{counts['plate_nodes']:.0f}", "plate elements"),
                    (f"{counts['plate_resistances']:.0f}", "resistances on the plate"),
                    (f"{counts['states']:.0f}", "states"),
                    (
                        f"{counts['plate_capacitance_J_per_K']:.1f} J/K",
                        "heat capacity of the plate",
                    ),
                    (f"{counts['plate_to_ambient_W_per_K']:.3f} W/K", "plate to ambient"),
                )
            ),
            Picture("netlist", to_png(plot_netlist(twin)), caption),
        ),
    )
    return section, counts
