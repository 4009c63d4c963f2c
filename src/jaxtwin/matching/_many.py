"""Many sets of recordings matched in one batch."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from .._errors import MatchError
from ..io import Experiment
from ..physics import Twin
from ._estimate import estimate
from ._fit import Fit
from ._levenberg_marquardt import BoundedLevenbergMarquardt
from ._match import Events, checked_recordings, default_solver, make_fit, make_setting
from ._unknowns import choose_unknowns


def match_many(
    twin: Twin,
    sets: Sequence[Sequence[Experiment]],
    *,
    free: Iterable[str] | None = None,
    fixed: Iterable[str] = (),
    shared: Iterable[str] = (),
    per_recording: Iterable[str] = (),
    bounds: Mapping[str, tuple[float, float]] | None = None,
    events: Events | None = None,
    robust: float | None = None,
    max_iterations: int = 200,
    solver: BoundedLevenbergMarquardt | None = None,
    on_iteration: Callable[[int, int], None] | None = None,
) -> tuple[Fit, ...]:
    """Matches the same twin to many sets of recordings, each on its own, in batches.

    All descend together through one compiled program: hundreds of synthetic recordings for a study
    of coverage, resampled ones for a bootstrap, the same test on many benches.

    **Arguments:**

    - `twin`: where each match starts.
    - `sets`: the recordings of each match. All sets have equally many, equally long, with the same
      number of input changes and of channels.
    - `on_iteration`: called with the number of the set and of its iteration.
    - the others: as in `match`.

    **Returns:** a `Fit` for each set, in order. One that ended at temperatures that are not finite
    has a `cost` of NaN or infinity and is not `converged`.

    **Raises:** as `match`; `MatchError` too where there is no set or they differ in shape.
    """
    if not sets:
        raise MatchError("sets: found none, allowed is one or several sets of recordings")
    began = time.perf_counter()
    recordings = [list(one) for one in sets]
    shapes = [[(one.duty.shape, len(one.channels)) for one in some] for some in recordings]
    for number, shape in enumerate(shapes):
        if shape != shapes[0]:
            raise MatchError(
                f"sets: found set {number} with recordings of other shapes than set 0, allowed are "
                "equally many recordings of equal length with equally many channels"
            )
    names = [checked_recordings(twin, one) for one in recordings]
    unknowns = choose_unknowns(
        twin,
        len(recordings[0]),
        free=free,
        fixed=fixed,
        shared=shared,
        per_recording=per_recording,
        bounds=bounds,
    )
    settings = [
        make_setting(twin, one, name, unknowns, events, None, robust)
        for one, name in zip(recordings, names, strict=True)
    ]
    results = estimate(
        settings,
        solver or default_solver(settings[0]),
        [unknowns.start()] * len(settings),
        max_iterations,
        None if on_iteration is None else lambda number, step: on_iteration(number, step[0]),
    )
    return tuple(
        make_fit(setting, knowledge, attempt, 0, name, (), began)
        for setting, (attempt, knowledge), name in zip(settings, results, names, strict=True)
    )
