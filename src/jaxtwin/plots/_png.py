"""Pictures as files."""

import io

from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure


def to_png(drawn: Figure | Axes, dpi: int = 150) -> bytes:
    """A picture as the content of a .png file. Its figure is closed.

    **Arguments:**

    - `drawn`: a figure or axes that a plot function returned.
    - `dpi`: the resolution in pixels per inch.

    **Returns:** the bytes of the file.
    """
    figure = drawn if isinstance(drawn, Figure) else drawn.get_figure(root=True)
    assert figure is not None  # axes that a plot function returns belong to a figure
    if not figure.stale:  # its parts are still as the plot function has arranged them
        figure.set_layout_engine(None)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=dpi, facecolor="auto")
    pyplot.close(figure)
    return content.getvalue()
