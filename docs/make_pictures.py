"""The pictures of the README and of these pages: `make pictures`.

Needs the authors' three step recordings (`jaxtwin data fetch`). Nearly all of its time goes into
one match of `dual-cell` to them.
"""

from pathlib import Path

import jaxtwin as jt
from jaxtwin import plots

FOLDER = Path(__file__).parent / "images"
TIMES = (120.0, 480.0, 980.0)
"""Of the maps, s: while the plate warms up, and near the end of each of the two steps."""


def main() -> None:
    """Matches, draws and writes."""
    experiments = [jt.read_recording(path) for path in jt.find_recordings()]
    fit = jt.match(jt.Twin("dual-cell"), experiments)
    runs = list(fit.runs.values())
    pictures = {
        "comparison": plots.plot_comparison(runs),
        "plate-beside": plots.plot_plate_beside(fit.twin.rig, runs, TIMES),
        "camera-error": plots.plot_camera_error(fit),
        "network": plots.plot_netlist(jt.Twin("dual-cell")),
    }
    FOLDER.mkdir(exist_ok=True)
    for name, picture in pictures.items():
        (FOLDER / f"{name}.png").write_bytes(plots.to_png(picture, dpi=110))
        print(FOLDER / f"{name}.png")


if __name__ == "__main__":
    main()
