"""Spans without a reading, and how long each sample has been without one."""

import numpy as np
from jaxtyping import Bool, Float

# Begin and end of each span, s. A span contains its begin, and not its end.
Spans = Float[np.ndarray, "_spans 2"]


def periodic_spans(every: float, length: float, until: float) -> Spans:
    """The spans of a length that begin at multiples of an interval, s; none if this is 0."""
    if every == 0:
        return np.zeros((0, 2))
    begins = every * np.arange(1, int(until / every) + 1)
    return np.column_stack([begins, begins + length])


def is_within(times: Float[np.ndarray, " times"], spans: Spans) -> Bool[np.ndarray, " times"]:
    """Whether each time is in one of the spans."""
    spans = _merged(spans, 0.0)
    return times < _last_span(times, spans)[:, 1]


def longest_silence(
    times: Float[np.ndarray, " samples"], spans: Spans, period: float
) -> Float[np.ndarray, " samples"]:
    """The longest time between two readings since the sample before, or until now if none has
    arrived, s.

    **Arguments:**

    - `times`: the times of the samples, s.
    - `spans`: the spans without a reading. `period`: the time between two readings outside of them,
      s.
    """
    spans = _merged(spans, period)
    last = _last_span(times, spans)
    silence = np.where(times < last[:, 1], times - last[:, 0] + period, 0.0)
    over = spans[spans[:, 1] <= times[-1]]
    np.maximum.at(silence, np.searchsorted(times, over[:, 1]), over[:, 1] - over[:, 0] + period)
    return silence


def _merged(spans: Spans, gap: float) -> Spans:
    """The spans in order, without overlaps. Those that are closer together than `gap` are one."""
    spans = spans[np.argsort(spans[:, 0])]
    ends = np.maximum.accumulate(spans[:, 1])
    is_apart = spans[1:, 0] >= ends[:-1] + gap * (1 - 1e-9)
    first = np.append(True, is_apart)[: len(spans)]
    last = np.append(is_apart, True)[: len(spans)]
    return np.column_stack([spans[first, 0], ends[last]])


def _last_span(times: Float[np.ndarray, " times"], spans: Spans) -> Float[np.ndarray, "times 2"]:
    """The last span that has begun at each time; an empty one before the first."""
    padded = np.concatenate([[[-np.inf, -np.inf]], spans])
    return padded[np.searchsorted(padded[:, 0], times, side="right") - 1]
