"""A twin or a controller as an FMU: a zip file with a description, C, and a binary for this
machine."""

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, final

import numpy as np

from .._arguments import of_kind, path_of
from .._celsius import ZERO_CELSIUS
from .._whole_file import check_ending, write_whole_file
from ..c_export._controller_c import controller_c
from ..c_export._parametric_twin_c import parametric_twin_c, settable_parameters
from ..c_export._sources import Code, defines, included, renamed, table
from ..control import AbstractController
from ..errors import ControlError
from ..matching import Fit, nominal_twin
from ..physics import Twin
from ..rig import Rig
from ..simulation import Stepper
from ._model_description import (
    Variable,
    build_description,
    model_description,
    names_c,
    variables_of,
)


class ControllerParts(NamedTuple):
    """What an FMU of a controller is made of.

    - `variables`: its variables. `code`: the controller as C.
    - `numbers`: the C of `model_fmu.h`, without the token.
    """

    variables: list[Variable]
    code: Code
    numbers: str


def controller_parts(
    controller: AbstractController, rig: Rig, name: str, origin: str
) -> ControllerParts:
    """Makes variables and sources: time, a reference for each output, the channels that it reads,
    the duty of each cell, and the duty that it takes over at the start.

    **Raises:** `ControlError` as `export_c`.
    """
    code = controller_c(controller, rig, name, "double", origin)
    channels = np.array([channel.name for channel in rig.channels])
    weights = np.asarray(controller.for_rig(rig).reading_weights(list(channels)), float)
    read = weights.any(axis=0)
    outputs = controller.output_names(list(channels))
    room = float(rig.ambient_temperature.evaluate(Twin(rig).numbers_si)) - ZERO_CELSIUS
    variables = _variables(outputs, list(channels[read]), rig, room)
    numbers = (
        defines(name, {"CHANNELS": int(read.sum()), "ROOM": room}, "double")
        + table(f"{name}_weights", weights[:, read], "of channels in readings", "double")
        + names_c(name, variables)
    )  # fmt: skip
    return ControllerParts(variables, code, numbers)


def _variables(
    outputs: tuple[str, ...], channels: list[str], rig: Rig, room: float
) -> list[Variable]:
    cells = [
        (name, (lowest, 1.0)) for name, lowest in zip(rig.driven, rig.lowest_duty, strict=True)
    ]
    rows = [
        Variable("time", 0, "independent", "s", None, None, "Time"),
        *(
            Variable(f"reference.{n + 1}", 0, "input", "degC", room, None, f"Reference of {name}")
            for n, name in enumerate(outputs)
        ),
        *(
            Variable(name, 0, "input", "degC", room, None, "Reading of the channel, NaN for none")
            for name in channels
        ),
        *(
            Variable(f"duty.{name}", 0, "output", "", None, full, "Duty cycle, positive heats")
            for name, full in cells
        ),
        *(
            Variable(f"start_duty.{name}", 0, "parameter", "", 0.0, full, "Duty before the start")
            for name, full in cells
        ),
    ]
    return [variable._replace(reference=number) for number, variable in enumerate(rows)]


VERSIONS = ("2.0", "3.0")

# Platform of Python -> its name in FMI, and the ending of its libraries.
SYSTEMS = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("win", ".dll")}


@final
@dataclass(frozen=True)
class FMU:
    """The file that `export_fmu` wrote, and its variables.

    - `path`: the path of the file.
    - `inputs`, `outputs`, `parameters`: the names of its variables. Parameters, and the nodes
      (`node.NAME`), can be set before the start.
    - `binary`: the platform of its binary; None if it contains only sources.
    """

    path: Path
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    binary: str | None


def export_fmu(
    model: Twin | Fit | AbstractController,
    path: str | os.PathLike[str],
    *,
    rig: Rig | None = None,
    step_size: float | int | None = None,
    version: Literal["2.0", "3.0"] = "2.0",
    compiler: str | None = "cc",
    origin: str = "",
) -> FMU:
    """Writes a twin as an FMU for model exchange and co-simulation, which other simulators run; or
    a controller, for co-simulation.

    ```python
    jt.export_fmu(jt.Twin("dual-cell"), "dual-cell.fmu")
    ```

    The FMU is the nonlinear twin of `Stepper`, as C. Its inputs are the duty cycles (`duty.P1`, -1
    to 1) and the ambient temperature, degC. Its outputs are the temperatures of the channels, degC.
    The temperatures of the nodes (`node.V11`) can be read, and can be set before the start. So can
    the parameters of the twin (`R_E`), within the bounds of the rig; the FMU then computes its
    network anew.

    In co-simulation the FMU takes steps of `step_size`, independently of the steps of the
    simulator. The inputs are held from the beginning of a step, and the outputs are those at the
    end of the last step. In model exchange the simulator's solver integrates the temperatures of
    the nodes and the driver's lag, and the driver's delay is a series of time events.

    The FMU of a controller is that of `export_c`. Its inputs are the references (`reference.1`,
    degC) and the channels that it reads, with the names of the twin's outputs; its outputs the duty
    cycles (`duty.P1`). It takes over the duty `start_duty.P1`, a parameter. A sample is taken at
    the beginning of the communication step in which it is due, and its duty is there at the end.

    **Arguments:**

    - `model`: the rig and its parameters; or a fit, of which the nominal twin is used; or a
      controller whose class has a law in C.
    - `rig`: the rig of a controller; None for a twin.
    - `path`: the path of the file, which ends in .fmu. An existing file is replaced.
    - `step_size`: the step of co-simulation of a twin, s; None for 1 s. A controller has its sample
      time.
    - `version`: the version of FMI.
    - `compiler`: the C compiler for the binary, with the options of cc or gcc. With None the file
      contains only sources, for simulators that compile them.
    - `origin`: the origin of the parameters, a line for the sources.

    **Returns:** the file, and the names of its inputs and outputs.

    **Raises:** `ControlError` for another version or ending, and if the compiler is not found
    or fails; `SimulationError` and `ParameterError` as `Stepper` does.
    """
    if version not in VERSIONS:
        raise ControlError(f"export_fmu: version: expected '2.0' or '3.0', got {version!r}")
    check_ending(path, [".fmu"], ControlError)
    target = path_of("export_fmu: path", path, ControlError)
    if isinstance(model, AbstractController):
        contents = _of_controller(model, rig, step_size, version, origin)
    else:
        contents = _of_twin(model, rig, step_size, version, origin)
    name, variables, sources = contents.name, contents.variables, contents.sources
    compiled = [file for file in sources if file.endswith(".c")]
    token = hashlib.sha256("".join(sources.values()).encode()).hexdigest()[:32]
    sources = {file: text.replace("@TOKEN@", token) for file, text in sources.items()}
    files = {f"sources/{file}": text.encode("ascii") for file, text in sources.items()}
    if version == "3.0":
        files["sources/buildDescription.xml"] = build_description(name, compiled)
    files["modelDescription.xml"] = model_description(
        variables,
        version=version,
        title=contents.title,
        identifier=name,
        token=token,
        step_size=contents.step_size,
        generator="jaxtwin",
        sources=compiled,
        about=contents.about,
        has_model_exchange=contents.has_model_exchange,
    )
    binary = None
    if compiler is not None:
        binary, library = _platform(version)
        files[f"binaries/{binary}/{name}{library}"] = _compiled(compiler, sources, library)
    _write(target, files)
    names = {
        causality: tuple(v.name for v in variables if v.causality == causality)
        for causality in ("input", "output", "parameter")
    }
    return FMU(target, names["input"], names["output"], names["parameter"], binary)


class _Contents(NamedTuple):
    """What is in an FMU: its name in C and for people, its variables, and file name -> C, with a
    placeholder for the token."""

    name: str
    title: str
    about: str
    variables: list[Variable]
    sources: dict[str, str]
    step_size: float
    has_model_exchange: bool


def _of_twin(
    twin: Twin | Fit, rig: Rig | None, step_size: float | int | None, version: str, origin: str
) -> _Contents:
    plant = nominal_twin("export_fmu: model", twin, ControlError)
    if rig is not None:
        raise ControlError("export_fmu: rig: expected None for a twin, which has its own, got one")
    step = 1.0 if step_size is None else float(step_size)
    stepper = Stepper(plant, step)
    name = _identifier("twin", plant.rig)
    variables = variables_of(plant, stepper)
    sources = _sources(plant, stepper, variables, name, version, origin)
    about = "A twin of a thermoelectric rig"
    return _Contents(name, plant.rig.name, about, variables, sources, step, True)


def _of_controller(
    controller: AbstractController,
    rig: Rig | None,
    step_size: float | int | None,
    version: str,
    origin: str,
) -> _Contents:
    of_kind("export_fmu: rig", rig, Rig, "the rig of the controller", ControlError)
    assert rig is not None
    if step_size is not None:
        raise ControlError(
            "export_fmu: step_size: expected None for a controller, which has its sample time of "
            f"{controller.sample_time_s:g} s, got {step_size!r}"
        )
    name = _identifier("controller", rig)
    variables, code, numbers = controller_parts(controller, rig, name, origin)
    wrapper = "fmi2.c" if version == "2.0" else "fmi3.c"
    instance = included(Path(__file__).with_name("controller_instance.c"), {})
    text = included(Path(__file__).with_name(wrapper), {"instance.c": instance})
    sources = {
        f"{name}.h": code.header,
        f"{name}_numbers.h": code.numbers,
        f"{name}.c": code.source,
        f"{name}_fmu.h": f'#define {name.upper()}_TOKEN "@TOKEN@"\n' + numbers,
        wrapper: renamed(text, name),
    }
    title, about = f"{rig.name} controller", "A controller of a thermoelectric rig"
    return _Contents(name, title, about, variables, sources, controller.sample_time_s, False)


def _identifier(kind: str, rig: Rig) -> str:
    return f"{kind}_" + re.sub(r"\W", "_", rig.name, flags=re.ASCII)


def _sources(
    twin: Twin,
    stepper: Stepper,
    variables: Sequence[Variable],
    name: str,
    version: str,
    origin: str,
) -> dict[str, str]:
    """Returns file name -> text, with a placeholder for the token."""
    parameters = settable_parameters(twin)
    code = parametric_twin_c(twin, stepper, name, origin, parameters)
    wiring = stepper.system.wiring
    # An array of C has at least one entry.
    rows = [variable for variable in variables if variable.causality == "parameter"]
    ends = [variable.limits or (-np.inf, np.inf) for variable in rows]
    largest = np.finfo(float).max
    lower, upper = np.clip(np.array([*ends, (0.0, 0.0)]), -largest, largest).T
    arrays = {
        "start": ([*np.asarray(stepper.start().nodes)], "temperatures of the nodes, degC"),
        "lowest": ([*wiring.lowest_duty], "duty cycles of cells and heaters"),
        "inputs": (
            [*(rig_input.value for rig_input in wiring.inputs), 0.0],
            "other inputs of the rig file",
        ),
        "states": (
            [*(len(rig_input.states) for rig_input in wiring.inputs), 0.0],
            "of them, 0 for numbers",
        ),
        "parameters": ([*(row.start for row in rows), 0.0], "values of the parameters"),
        "lower": (lower, "bounds of the parameters"),
        "upper": (upper, "bounds of the parameters"),
    }
    lagged = 0 if stepper.system.lag is None else len(wiring.cold)
    wrapper = "fmi2.c" if version == "2.0" else "fmi3.c"
    return {
        f"{name}.h": code.header,
        f"{name}_numbers.h": code.numbers,
        f"{name}.c": code.source,
        f"{name}_fmu.h": f'#define {name.upper()}_TOKEN "@TOKEN@"\n'
        + defines(name, {"LAGGED": lagged}, "double", {"LAGGED": "duty cycles behind the lag"})
        + "".join(
            table(f"{name}_{key}", np.array(values, float), comment, "double")
            for key, (values, comment) in arrays.items()
        )
        + names_c(name, variables),
        wrapper: renamed(included(Path(__file__).with_name(wrapper), {}), name),
    }


def _platform(version: str) -> tuple[str, str]:
    """The name of this platform in FMI, and the ending of its libraries.

    **Raises:** `ControlError` for a system that has no name in FMI.
    """
    if sys.platform not in SYSTEMS:
        raise ControlError(
            f"export_fmu: compiler: expected Linux, macOS or Windows for a binary, got "
            f"{sys.platform}; compiler=None writes sources alone"
        )
    system, library = SYSTEMS[sys.platform]
    if version == "2.0":
        return system + ("64" if sys.maxsize > 2**32 else "32"), library
    machine = platform.machine().lower()
    architecture = {"amd64": "x86_64", "arm64": "aarch64"}.get(machine, machine)
    return f"{architecture}-{'windows' if system == 'win' else system}", library


def _compiled(compiler: str, sources: dict[str, str], library: str) -> bytes:
    """Compiles the sources and returns the shared library.

    **Raises:** `ControlError` if the compiler is not found or fails.
    """
    program = shutil.which(compiler)
    if program is None:
        raise ControlError(
            f"export_fmu: compiler: expected a C compiler, got {compiler!r}, which is not "
            "found; install it, or pass compiler=None for an FMU of sources alone"
        )
    with tempfile.TemporaryDirectory() as folder:
        for file, text in sources.items():
            (Path(folder) / file).write_text(text, encoding="ascii")
        out = f"model{library}"
        command = [program, "-std=c99", "-O2", "-shared", "-fPIC", "-fvisibility=hidden"]
        command += [*(file for file in sources if file.endswith(".c")), "-o", out, "-lm"]
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if done.returncode:
            raise ControlError(
                f"export_fmu: compiler: {compiler} failed: {done.stderr.strip()[-500:]}"
            )
        return (Path(folder) / out).read_bytes()


def _write(target: Path, files: dict[str, bytes]) -> None:
    """Writes the zip file. Equal contents give equal bytes."""
    with tempfile.TemporaryDirectory() as folder:
        whole = Path(folder) / "model.fmu"
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
            for file, content in files.items():
                entry = zipfile.ZipInfo(file, (1980, 1, 1, 0, 0, 0))
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, content, zipfile.ZIP_DEFLATED)
        write_whole_file(target, whole.read_bytes(), ControlError)
