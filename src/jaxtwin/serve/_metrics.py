"""The numbers of a page as text for Prometheus.

The format is that of https://prometheus.io/docs/instrumenting/exposition_formats, version 0.0.4.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"


class Metric(NamedTuple):
    """A metric.

    - `name`: with its unit, such as `jaxtwin_temperature_celsius`. `kind`: `gauge` or `counter`.
    - `about`: what it is, a sentence.
    - `label`: the name of the label that tells its values apart; `""` if it has one value.
    - `values`: the value of each label.
    """

    name: str
    kind: str
    about: str
    label: str
    values: Mapping[str, float]


def metrics_text(rigs: Mapping[str, Sequence[Metric]]) -> str:
    """Writes the metrics of rigs, the same of each, with a label `rig` as text."""
    several = zip(*rigs.values(), strict=True)
    return "".join(line + "\n" for metrics in several for line in _lines(rigs, metrics))


def _lines(rigs: Iterable[str], metrics: Sequence[Metric]) -> Iterator[str]:
    yield f"# HELP {metrics[0].name} {_escaped(metrics[0].about)}"
    yield f"# TYPE {metrics[0].name} {metrics[0].kind}"
    for rig, metric in zip(rigs, metrics, strict=True):
        for label, value in metric.values.items():
            own = f',{metric.label}="{_quoted(label)}"' if metric.label else ""
            yield f'{metric.name}{{rig="{_quoted(rig)}"{own}}} {float(value):.9g}'


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n")


def _quoted(text: str) -> str:
    return _escaped(text).replace('"', r"\"")
