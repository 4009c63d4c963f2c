"""The rig of a report and the thermal network that it becomes."""

from ..physics import Twin
from ..physics._netlist import network_counts
from ..plots import plot_netlist, to_png
from ._blocks import KeyNumbers, ReportPicture, Section, Text

# Count of a network, its form, and what it is.
_COUNTS = (
    ("plate_nodes", "{:.0f}", "plate elements"),
    ("plate_resistances", "{:.0f}", "resistances on the plate"),
    ("states", "{:.0f}", "states"),
    ("resistances", "{:.0f}", "resistances"),
    ("plate_capacitance_J_per_K", "{:.1f} J/K", "heat capacity of the plate"),
    ("plate_to_ambient_W_per_K", "{:.3f} W/K", "plate to ambient"),
    ("capacitance_J_per_K", "{:.1f} J/K", "heat capacity"),
    ("to_ambient_W_per_K", "{:.3f} W/K", "to ambient"),
)


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
            KeyNumbers(
                tuple(
                    (form.format(counts[key]), words)
                    for key, form, words in _COUNTS
                    if key in counts
                )
            ),
            ReportPicture("netlist", to_png(plot_netlist(twin)), caption),
        ),
    )
    return section, counts
