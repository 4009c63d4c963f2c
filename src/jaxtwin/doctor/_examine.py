"""Collects everything that a report of a problem should contain."""

import os
import platform
import sys
from importlib import metadata

from .._compilation import MAX_CACHE, cache_state
from .._jax_settings import own_settings
from ..errors import RecordingError
from ..simulation import native_state

LIBRARIES = (
    "jax",
    "jaxlib",
    "diffrax",
    "optimistix",
    "equinox",
    "lineax",
    "numpy",
    "scipy",
    "matplotlib",
    "xarray",
    "h5netcdf",
)

TRAPS = {
    "several forced host devices": "XLA_FLAGS=--xla_force_host_platform_device_count and batched "
    "linear algebra can wait for each other for ever on a machine with few cores (seen with jax "
    "0.10.2). Use one device, or set PJRT_NPROC=4.",
    "derivatives of eigenvectors": "that of jnp.linalg.eigh is NaN where eigenvalues repeat, which "
    "they do on symmetric plates. It concerns code of your own around a network's matrix.",
    "host callbacks": "programs that hold one (diffrax with throw=True or SaveAt(ts=...)) are "
    "compiled anew in every process. The default solver has none.",
    "float32": "adaptive diffrax solvers at tight tolerances can end in inf without an error.",
}


def examine() -> dict[str, dict[str, str]]:
    """Examines versions, machine, JAX, caches and recordings.

    **Returns:** section -> entry -> text, in the order in which to print them.
    """
    return {
        "versions": _versions(),
        "machine": _machine(),
        "jax": _jax(),
        "compiled programs": _cache() | {"many draws": native_state().reason},
        "recordings": _recordings(),
        "known traps": TRAPS,
    }


def _versions() -> dict[str, str]:
    from .. import __version__

    result = {"jaxtwin": __version__, "python": platform.python_version()}
    for name in LIBRARIES:
        try:
            result[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            result[name] = "not installed"
    return result


def _machine() -> dict[str, str]:
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    threads = {
        name: os.environ[name]
        for name in ("OMP_NUM_THREADS", "PJRT_NPROC", "XLA_FLAGS")
        if name in os.environ
    }
    return {
        "system": f"{platform.system()} {platform.release()}, {platform.machine()}",
        "python": sys.executable,
        "CPU cores": f"{os.cpu_count()}, {usable} of them usable by this process",
        "thread settings": ", ".join(f"{k}={v}" for k, v in threads.items()) or "none",
    }


def _jax() -> dict[str, str]:
    import jax

    with own_settings():  # which says in a sentence if there is no device
        result = jax.devices()
    devices = [f"{device.platform} {device.id}: {device.device_kind}" for device in result]
    default = "on" if jax.config.read("jax_enable_x64") else "off"
    return {
        "devices": "; ".join(devices),
        "float64 by default": f"{default} (JAX's setting, which jaxtwin leaves alone)",
        "float64 in jaxtwin": "simulations, matches and sweeps switch it on for their own work",
    }


def _cache() -> dict[str, str]:
    state = cache_state()
    if state.folder is None:
        return {"state": state.reason}
    return {
        "state": f"on ({state.reason})",
        "folder": str(state.folder),
        "holds": f"{state.files} programs, {state.size / 2**20:.1f} of at most "
        f"{MAX_CACHE / 2**20:.0f} MiB; it may be deleted",
    }


def _recordings() -> dict[str, str]:
    from ..io import SINGLE_CELL, find_recordings

    result = {}
    for label, names in (
        ("two cells", None),
        ("one cell", [recording.name for recording in SINGLE_CELL]),
    ):
        try:
            paths = find_recordings() if names is None else find_recordings(names=names)
            result[label] = ", ".join(str(path) for path in paths)
        except RecordingError as error:
            result[label] = str(error)
    return result
