"""The web application of a fleet: its page, a page for each rig, metrics, and orders to refit."""

import asyncio
import math
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Awaitable, Callable, Mapping
from typing import Any, final

import numpy as np
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from .._statistics import QUANTILE_975
from ..live import finding_as_json, seconds
from ..observers import parameter_estimates
from ..serve._access import Access, Refusal
from ..serve._app import HEADERS, asset_files, command_body, refused
from ..serve._contents import HORIZON, STEPS, outlook_content, sample_content
from ..serve._metrics import CONTENT_TYPE, Metric, metrics_text
from ..serve._rig_layout import rig_layout
from ..serve._story import Sentence
from ._fleet import Fleet
from ._watched_rig import WatchedRig

# What a page shows of a fleet: a line for each rig, three sentences for all, and what several
# rigs have in common.


# The worst first.
LEVELS = ("critical", "warning", "notice", "unknown", "good")

# Question -> what is said of those for which the answer is good, and if it is good for all.
ANSWERS = {
    "rig": ("are well", "Nothing is found."),
    "twin": ("twins are right", "Nothing is unexplained."),
    "minute": ("stay within limits", "Nothing gets near its limit in the next minute."),
}

# What a kind of finding is called where several rigs have it.
WORDS = {
    "sudden": "a sudden change",
    "implausible": "unexplained heat, or another parameter",
    "drift": "a channel that drifts",
    "frozen": "a frozen channel",
    "gone": "a channel at the room",
    "silent": "no readings",
    "over-temperature": "too hot",
    "channel-fault": "a channel without readings",
}

# The smallest number of rigs of a group, and part of it, whose common fault is a trend.
MIN_RIGS = 3
MIN_FRACTION = 0.05

# The number of rigs that a sentence names.
SHOWN_RIGS = 3


def overview(fleet: Fleet) -> dict[str, Any]:
    """Describes a fleet as a dictionary that JSON can hold.

    **Returns:** `t`, s since 1970; `answers`, three sentences; `trends`, sentences; `problems`; and
    `rigs`, a line for each: its name, group and twin, level, head and text of whether it is well,
    and level and head of whether its twin is right and of what comes.
    """
    rigs = fleet.rigs
    stories = {name: rig.story() for name, rig in rigs.items()}
    return {
        "t": round(time.time(), 1),
        "answers": {name: _answer(stories, name)._asdict() for name in ANSWERS},
        "trends": trends(rigs),
        "problems": fleet.problems,
        "rigs": [
            {
                "name": name,
                "group": rigs[name].group,
                "twin": rigs[name].made.label,
                "rig": list(story["rig"]),
                "right": list(story["twin"][:2]),
                "next": list(story["minute"][:2]),
            }
            for name, story in stories.items()
        ],
    }  # fmt: skip


def trends(rigs: Mapping[str, WatchedRig]) -> list[dict[str, Any]]:
    """What several rigs of a group have in common: the most frequent first."""
    sizes = Counter(rig.group for rig in rigs.values())
    seen: defaultdict[tuple[str, str, bool], list[str]] = defaultdict(list)
    for name, rig in rigs.items():
        findings = [finding for finding in rig.findings if finding.is_alarm]
        if rig.cause:
            seen[rig.group, rig.fault, True].append(name)
        else:
            for kind in {finding.kind for finding in findings}:
                seen[rig.group, WORDS.get(kind, kind), False].append(name)
    common = [
        {
            "text": f"{len(names)} of {sizes[group]} in {group}: {what}{' (estimate)' * is_cause}",
            "rigs": names,
            "group": group,
        }
        for (group, what, is_cause), names in seen.items()
        if len(names) >= max(MIN_RIGS, MIN_FRACTION * sizes[group])
    ]
    return sorted(common, key=lambda trend: -len(trend["rigs"]))


def metrics_of(rig: WatchedRig) -> list[Metric]:
    """The numbers of a rig for a program that watches the fleet."""
    story, channels = rig.story(), rig.made.twin.channels

    def single(name: str, about: str, value: float | int) -> Metric:
        return Metric(f"jaxtwin_{name}", "gauge", about, "", {"": float(value)})

    def gauge(name: str, about: str, values: Any) -> Metric:
        pairs = zip(channels, [] if values is None else values.tolist(), strict=False)
        by_name = {channel: value for channel, value in pairs if math.isfinite(value)}
        return Metric(f"jaxtwin_{name}", "gauge", about, "channel", by_name)

    alarms = sum(finding.is_alarm for finding in rig.findings)
    age = rig.age
    return [
        single("rig_severity", "0 for a rig that is well, 4 for one that is critical.",
               len(LEVELS) - 1 - LEVELS.index(story["rig"].level)),
        single("twin_severity", "The same of whether its twin is right.",
               len(LEVELS) - 1 - LEVELS.index(story["twin"].level)),
        single("alarms", "The alarms that are there.", alarms),
        single("reading_age_seconds", "The time since the last message with readings.",
               math.nan if age is None else age),
        single("expectation_error_kelvin",
               "Readings minus expected readings, root mean square of a minute.", rig.error),
        single("surprise_ratio", "The mean normalised innovation squared of a minute.",
               rig.nis),
        gauge("temperature_celsius", "What a channel reads.", rig.measured),
        gauge("expected_celsius", "What the twin expected of a channel.",
              None if rig.measured is None else rig.expected),
        Metric("jaxtwin_messages_total", "counter",
               "Readings that were used, and messages that were late, malformed or too many.",
               "how",
               dict(rig.queue.counts)),
    ]  # fmt: skip


def _answer(stories: Mapping[str, Mapping[str, Sentence]], question: str) -> Sentence:
    """For how many rigs the answer to a question is good, and what the worst are."""
    answers, (some, nothing) = (
        {name: story[question] for name, story in stories.items()},
        ANSWERS[question],
    )
    levels = Counter(sentence.level for sentence in answers.values())
    worst: Any = next((level for level in LEVELS if levels[level]), "unknown")
    if worst == "good":
        return Sentence("good", f"All {len(answers)} {some}", nothing)
    names = [name for name, sentence in answers.items() if sentence.level == worst]
    heads = Counter(answers[name].head for name in names).most_common(SHOWN_RIGS)
    what = "; ".join(f"{count}: {head.lower()}" for head, count in heads)
    more = f" and {len(names) - SHOWN_RIGS} more" * (len(names) > SHOWN_RIGS)
    text = f"{what} ({', '.join(names[:SHOWN_RIGS])}{more})."
    return Sentence(worst, f"{levels['good']} of {len(answers)} {some}", text)


# The longest time for which an overview is shown, s: it is the same for all clients.
OVERVIEW_SECONDS = 1.0

# The time without a turn of the loop after which the fleet is not healthy, s.
STUCK_SECONDS = 30.0

# The number of findings of a rig that its page shows.
SHOWN_FINDINGS = 60


Answer = Callable[[Request], Awaitable[Response]]


def fleet_app(fleet: Fleet, access: Access) -> Starlette:
    """Makes the ASGI application of a fleet."""
    web = _FleetApp(fleet, access)

    def checked(answer: Answer) -> Answer:
        async def answer_checked(request: Request) -> Response:
            return web.refusal(request) or await answer(request)

        return answer_checked

    routes = [
        Route("/", checked(web.page), methods=["GET"]),
        Route("/rigs/{name}", checked(web.page), methods=["GET"]),
        Route("/assets/{name:path}", checked(web.asset), methods=["GET"]),
        Route("/overview", checked(web.overview), methods=["GET"]),
        Route("/rigs/{name}/frames", checked(web.frames), methods=["GET"]),
        Route("/rigs/{name}/history", checked(web.history), methods=["GET"]),
        Route("/rigs/{name}/refit", checked(web.refit), methods=["POST"]),
        Route("/metrics", checked(web.metrics), methods=["GET"]),
        Route("/healthz", checked(web.health), methods=["GET"]),
    ]
    app = Starlette(routes=routes)
    app.state.close = lambda: None
    return app


@final
class _FleetApp:
    """The answers to requests."""

    def __init__(self, fleet: Fleet, access: Access):
        self._fleet, self._access = fleet, access
        self._assets = dict(asset_files("jaxtwin.serve")) | {
            f"fleet/{name}": content for name, content in asset_files("jaxtwin.fleet")
        }
        self._overview: tuple[float, dict[str, Any]] = (-OVERVIEW_SECONDS, {})
        self._lock = threading.Lock()

    async def page(self, request: Request) -> Response:
        name = "rig.html" if "name" in request.path_params else "fleet.html"
        headers = {**HEADERS, "cache-control": "no-store"}
        return Response(self._assets[f"fleet/{name}"][0], 200, headers, "text/html")

    async def asset(self, request: Request) -> Response:
        name = request.path_params["name"]
        if name not in self._assets or name.endswith(".html"):
            return refused(Refusal(404, "there is no such file"))
        content, kind, tag = self._assets[name]
        headers = {**HEADERS, "cache-control": "no-cache", "etag": tag}
        if request.headers.get("if-none-match") == tag:
            return Response(status_code=304, headers=headers)
        return Response(content, 200, headers, kind)

    async def overview(self, request: Request) -> Response:
        return self._json(await asyncio.to_thread(self._look))

    async def frames(self, request: Request) -> Response:
        rig = self._fleet.rigs[request.path_params["name"]]
        return self._json(await asyncio.to_thread(self._frames, rig))

    async def history(self, request: Request) -> Response:
        rig = self._fleet.rigs[request.path_params["name"]]
        return self._json(await asyncio.to_thread(rig.history.over, 3600.0))

    async def refit(self, request: Request) -> Response:
        body = await command_body(request, self._access, needs_control=True)
        if isinstance(body, Refusal):
            return refused(body)
        if why := self._fleet.ask_for_refit(request.path_params["name"]):
            return refused(Refusal(409, why))
        return self._json({"text": "the champion is being refitted; the log says what is decided"})

    async def metrics(self, request: Request) -> Response:

        def text() -> str:
            return metrics_text({name: metrics_of(rig) for name, rig in self._fleet.rigs.items()})

        content = await asyncio.to_thread(text)
        return Response(content, 200, {**HEADERS, "content-type": CONTENT_TYPE})

    async def health(self, request: Request) -> Response:
        waited = time.monotonic() - self._fleet.turned
        is_well = waited < STUCK_SECONDS and self._fleet.is_connected
        status = "ok" if is_well else "stuck" if self._fleet.is_connected else "no broker"
        content = {"status": status, "loop_age_s": round(waited, 3)}
        headers = {**HEADERS, "cache-control": "no-store"}
        return JSONResponse(content, 200 if is_well else 503, headers)

    def refusal(self, request: Request) -> Response | None:
        """Why a request that changes nothing is refused; None if it is not."""
        if refusal := self._access.refuse_read(request.headers):
            return refused(refusal)
        name = request.path_params.get("name")
        is_rig = request.url.path.startswith("/rigs/")
        if is_rig and name not in self._fleet.rigs:
            return refused(Refusal(404, "there is no such rig"))
        return None

    def _look(self) -> dict[str, Any]:
        with self._lock:
            if time.monotonic() - self._overview[0] >= OVERVIEW_SECONDS:
                self._overview = time.monotonic(), overview(self._fleet)
            return self._overview[1]

    def _frames(self, rig: WatchedRig) -> list[tuple[str, Any]]:
        """The frames of a rig, as those of `jaxtwin serve`, from which its page is drawn."""
        observer, twin = rig.made.watcher[0], rig.made.twin
        directions, rows = observer.model.directions, twin.rig.parameters
        names = () if directions is None else directions.names
        layout = {
            **rig_layout(twin),
            "rig": rig.name,
            "source": f"group {rig.group}, {self._fleet.file.topic(rig.name, 'readings')}",
            "is_live": True,
            "recording": self._fleet.file.journal.name,
            "control": self._access.allow_control and rig.made.member.store is not None,
            "outputs": (),
            "twin": rig.made.label,
            "horizon": HORIZON,
            "uncertain": [
                {
                    "name": name,
                    "unit": rows[name].unit,
                    "description": rows[name].description,
                    "value": float(twin.values[name]),
                }
                for name in names
            ],
        }
        outlook, measured = rig.outlook(), rig.measured  # before the story, which tells of it
        story = {name: sentence._asdict() for name, sentence in rig.story().items()}
        present = [finding_as_json(finding) for finding in rig.findings]
        keys = [(finding["kind"], finding["channel"], finding["found"]) for finding in present]
        before = [
            {**finding, "until": finding["until"] or finding["found"]}
            for finding in self._fleet.findings(rig.name, SHOWN_FINDINGS)
            if (finding["kind"], finding["channel"], finding["found"]) not in keys
        ]
        findings = sorted([*present, *before], key=lambda finding: -(finding["since"] or 0))
        frames: list[tuple[str, Any]] = [
            ("layout", layout),
            ("story", {"t": round(time.time(), 1), **story, "links": {}, "counts": {}, "trip": ""}),
            ("findings", findings),
            ("diagnosis", rig.diagnosis),
            ("log", list(rig.lines)),
        ]
        if outlook is not None and measured is not None:
            now = seconds(rig.queue.time)
            band = np.asarray(QUANTILE_975 * outlook.expected_spread)
            ambient = rig.queue.ambient
            frames.append(
                ("sample", sample_content(
                    now, measured, rig.expected, band, rig.queue.duty,
                    None if ambient != ambient else ambient,
                ))
            )  # fmt: skip
            times = [now + HORIZON / STEPS * (number + 1) for number in range(STEPS)]
            estimates = parameter_estimates(directions, outlook.now.values)
            elements = twin.wiring.elements
            frames.append(
                ("outlook", outlook_content(outlook, elements, now, times, 0.0, estimates))
            )
        return frames

    @staticmethod
    def _json(content: Any) -> Response:
        return JSONResponse(content, headers={**HEADERS, "cache-control": "no-store"})
