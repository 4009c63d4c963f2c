"""The numbers of a page as text for Prometheus.

The format is that of https://prometheus.io/docs/instrumenting/exposition_formats, version 0.0.4.
"""

from collections.abc import Iterator, Mapping
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


def metrics_text(metrics: list[Metric], rig: str) -> str:
    """Writes metrics, each with a label `rig`, as text."""
    return "".join(line + "\n" for metric in metrics for line in _lines(metric, rig))


def _lines(metric: Metric, rig: str) -> Iterator[str]:
    yield f"# HELP {metric.name} {_escaped(metric.about)}"
    yield f"# TYPE {metric.name} {metric.kind}"
    for label, value in metric.values.items():
        own = f',{metric.label}="{_quoted(label)}"' if metric.label else ""
        yield f'{metric.name}{{rig="{_quoted(rig)}"{own}}} {float(value):.9g}'


def _escaped(text: str) -> str:
    return text.replace("\\", r"\\").replace("\n", r"\n")


def _quoted(text: str) -> str:
    return _escaped(text).replace('"', r"\"")
