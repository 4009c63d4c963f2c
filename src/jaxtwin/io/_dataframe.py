"""Recordings as tables of pandas or polars, with the columns of a .csv recording."""

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from .._name_suggestions import did_you_mean
from ..errors import RecordingError
from ..rig import Rig
from ._column_meaning import Choices, Meaning
from ._delimited import Column, in_unit
from ._experiment import Experiment
from ._named_columns import meanings
from ._recorded_columns import RecordedDrive, experiment_of_columns
from ._timestamps import is_timestamp_title

if TYPE_CHECKING:
    import pandas
    import polars  # pyright: ignore[reportMissingImports]


def experiment_of_dataframe(
    frame: "pandas.DataFrame | polars.DataFrame",
    *,
    rig: Rig | None,
    time: str | None,
    counts: int | None,
    polarity: int,
    name: str,
) -> Experiment:
    """The experiment in a table; for the arguments see `Experiment.from_dataframe`."""
    import pandas

    frame = _of_pandas(frame)
    if time is not None and time not in frame.columns:
        known = ", ".join(map(str, frame.columns))
        raise RecordingError(
            f"from_dataframe: time: expected one of {known}, got {time!r}"
            f"{did_you_mean([str(time)], map(str, frame.columns))}"
        )
    twice = frame.columns[frame.columns.duplicated()]
    if len(twice):
        raise RecordingError(f"columns: expected each name once, got {twice[0]!r} twice")
    _refuse_text_and_bare_times(frame, time)
    rows = list(range(len(frame)))
    columns = []
    index = frame.index
    if time is None and not isinstance(index, pandas.DatetimeIndex | pandas.TimedeltaIndex):
        clocks = [title for title in frame.columns if frame[title].dtype.kind in "mM"]
        time = clocks[0] if clocks else None
        from_index = not clocks and not any(map(_is_time, frame.columns))
    else:
        from_index = time is None
    if from_index:
        title = str(index.name or "index")
        if type(index) is pandas.RangeIndex and not _is_time(title):
            known = ", ".join(map(str, frame.columns))
            raise RecordingError(
                "from_dataframe: expected a column of times, such as time_s, or time= with its "
                f"name, got the columns {known}; numbers of rows are no times"
            )
        columns.append(_times(title, index.to_series(), rows))
    for title in frame.columns:
        series: pandas.Series = frame.loc[:, title]
        meaning = _meaning(title, rig)
        if title == time:
            columns.append(_times(str(title), series, rows))
        elif meaning.kind == "input" and series.dtype.kind not in "iufb":
            texts = [str(value) for value in series]
            blank = np.full(len(texts), np.nan)
            columns.append(Column(str(title), "input", meaning.name, blank, rows, texts, "row"))
        else:
            columns.append(_column(meaning, in_unit(meaning, _numbers(series, str(title))), rows))
    if rig is None:
        return experiment_of_columns(columns, name, RecordedDrive(counts, polarity))
    if rig.driver.states_counts and counts is None:
        counts, polarity = rig.driver.counts, rig.driver.polarity
    drive = RecordedDrive(counts, polarity, names=rig.driven)
    return experiment_of_columns(columns, name, drive).for_rig(rig)


def _of_pandas(frame: object) -> "pandas.DataFrame":
    """The table as one of pandas. A table of polars is copied column by column, since its own
    conversion needs another library."""
    import pandas

    if type(frame).__module__.partition(".")[0] == "polars" and hasattr(frame, "to_dict"):
        frame = pandas.DataFrame(frame.to_dict(as_series=False))  # pyright: ignore
    if not isinstance(frame, pandas.DataFrame):
        raise RecordingError(
            "from_dataframe: frame: expected a DataFrame of pandas or polars, got "
            f"{type(frame).__name__}"
        )
    return frame


def _refuse_text_and_bare_times(frame: "pandas.DataFrame", time: str | None) -> None:
    """Refuses columns of text, and a column `time` of plain numbers without a unit. A column `time`
    must have a unit, or hold time stamps or durations."""
    for title in frame.columns:
        kind = frame[title].dtype.kind
        if title != time and is_timestamp_title(str(title)) and kind not in "mM":
            raise RecordingError(
                f"column {title}: expected time stamps (datetime) or durations (timedelta), got "
                f"{frame[title].dtype}; call a column of seconds time_s, or pass time={title!r}; "
                "pandas.to_datetime makes time stamps of text"
            )


def _meaning(title: object, rig: Rig | None = None) -> Meaning:
    (meaning,) = meanings([str(title)], Choices(rig=rig))
    assert meaning is not None, "nothing is left out"
    return meaning


def _times(title: str, series: "pandas.Series", rows: list[int]) -> Column:
    """The column of the times: in s, or of time stamps in us since 1970, by the clock of their
    zone."""
    import pandas

    seconds = _seconds(series, title)
    column = _column(Meaning(title, "time", "time"), seconds, rows)
    is_clock = series.dtype.kind == "M" or isinstance(series.dtype, pandas.DatetimeTZDtype)
    if not is_clock or not len(series):
        return column
    origin = series.iloc[0].replace(tzinfo=None) - pandas.Timestamp(0)
    # Not each stamp by itself: a clock that is set back in autumn would go back.
    stamps = origin // pandas.Timedelta(microseconds=1) + 1e6 * seconds
    return replace(column, values=stamps, is_since_1970=True)


def _is_time(title: object) -> bool:
    meaning = _meaning(title)
    return meaning.kind == "time" and meaning.unit is not None


def _column(meaning: Meaning, values: Float[np.ndarray, " samples"], rows: list[int]) -> Column:
    fields = [f"{value:g}" for value in values]
    return Column(meaning.title, meaning.kind, meaning.name, values, rows, fields, "row")


def _seconds(series: "pandas.Series", title: str) -> Float[np.ndarray, " samples"]:
    """Converts times to seconds: numbers are in the unit of their title, or in seconds, and time
    stamps are counted from the first of them."""
    import pandas

    if series.isna().any():
        row = int(np.flatnonzero(series.isna())[0])
        raise RecordingError(f"row {row}, column {title}: expected a time in every row, got none")
    if series.dtype.kind == "M" or isinstance(series.dtype, pandas.DatetimeTZDtype):
        series = series - series.iloc[0] if len(series) else series
    if series.dtype.kind == "m":
        return series.dt.total_seconds().to_numpy(dtype=np.float64)
    if series.dtype.kind not in "iuf":
        raise RecordingError(
            f"column {title}: expected seconds, durations (timedelta) or time stamps (datetime), "
            f"got {series.dtype}; pandas.to_datetime makes time stamps of text"
        )
    (meaning,) = meanings([title], Choices({title: "time"}))
    assert meaning is not None, "nothing is left out"
    return in_unit(meaning, _numbers(series, title))


def _numbers(series: "pandas.Series", title: str) -> Float[np.ndarray, " samples"]:
    """Returns the numbers of a column; NaN for a missing number."""
    try:
        values: Any = series.to_numpy(dtype=np.float64, na_value=np.nan)
    except (TypeError, ValueError):
        raise RecordingError(
            f"column {title}: expected numbers, got {series.dtype}; leave the column out, or make "
            "numbers of it"
        ) from None
    return values
