"""The page of a rig in a notebook."""

import threading
from collections.abc import Mapping
from contextlib import ExitStack
from typing import Any, final

from ..live import Replay, RigConnection, Service
from ..monitoring import MonitorCalibration
from ..observers import ProcessNoise
from ..physics import Twin
from ..serve import FrameRing, Page, TwinBeside
from ._notebook_widget import NotebookWidget


@final
class RigView(NotebookWidget):
    """A rig and its twin, as `jaxtwin serve` shows them, without commands.

    A thread of its own polls the rig until `close()`. Cells of the notebook go on running.

    **Arguments:**

    - `source`: the connection to a rig (`live.connect`), or a recording (`live.Replay`). The view
      starts it and closes it.
    - `twin`: the twin that follows the rig.
    - `noise`: the levels of the noise of its observer; None: usual ones.
    - `calibration`: what is healthy, for its monitor; None: usual thresholds.
    - `name`: the name of the source, for people.

    `problem` is the error that ended the thread; None while there is none.

    **Raises:** `RecordingError` for a recording of another rig; `JaxtwinError` without anywidget.
    """

    _thread: threading.Thread | None = None  # until it begins; a view that is refused is closed too

    def __init__(
        self,
        source: RigConnection | Replay,
        twin: Twin,
        *,
        noise: ProcessNoise | None = None,
        calibration: MonitorCalibration | None = None,
        name: str = "",
    ):
        if isinstance(source, Replay):
            source.check_rig(twin.rig)
        super().__init__("rig_view")
        self.problem: Exception | None = None
        self._source = source
        self._ring = FrameRing(on_frame=self._on_frame)
        self._over = threading.Event()
        beside = TwinBeside(twin, "given", noise=noise, calibration=calibration)
        is_live = isinstance(source, RigConnection)
        about = {"source": name or ("rig" if is_live else "replay"), "is_live": is_live}
        self._page = Page(self._ring, source, beside, {**about, "recording": "", "control": False})
        self._thread = threading.Thread(target=self._run, name="jaxtwin rig view", daemon=True)
        self._thread.start()

    def on_request(self, content: Mapping[str, Any]) -> None:
        """Answers a view: one that begins with the newest frames, or one that wants a history."""
        if content["kind"] == "hello":
            for kind, newest in self._ring.newest_contents():
                self.show(kind, newest)
        else:
            span = float(content["span"])
            self.show("history", {"span": span, **self._page.history.over(span)})

    def close(self) -> None:
        """Ends the thread, closes the source, and removes the views."""
        if self._thread is not None:
            self._over.set()
            self._thread.join()
        super().close()

    def _run(self) -> None:
        try:
            with ExitStack() as stack:
                stack.enter_context(self._source)
                service = Service(self._source, [self._page])
                service.run(self._over.is_set)
                service.take([])  # the last frames
        except Exception as error:  # nobody else would see that the values are old from now on
            self.problem = error
            self._page.problem = str(error)
            self._page.say("critical", str(error))

    def _on_frame(self, kind: str, text: str) -> None:
        self.show(kind, text)
