"""What the numbers were measured on."""

import os
import platform
import subprocess
from contextlib import suppress
from datetime import date
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import jax

LIBRARIES = (
    "jaxtwin",
    "jax",
    "jaxlib",
    "diffrax",
    "numpy",
    "scipy",
    "casadi",
    "lmfit",
)


def machine() -> dict[str, Any]:
    """Processor, memory, accelerators, versions, date, and how busy it was."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return {
        "date": date.today().isoformat(),
        "processor": processor(),
        "cores": len(os.sched_getaffinity(0)),
        "memory_GiB": round(memory / 2**30, 1),
        "devices": [f"{device.platform}: {device.device_kind}" for device in jax.devices()],
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "versions": _versions(),
        "load_before": round(os.getloadavg()[0], 2),
    }


def processor() -> str:
    """What the system calls it."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def compiler() -> str:
    """The C compiler, as it calls itself."""
    said = subprocess.run(["cc", "--version"], stdout=subprocess.PIPE, text=True, check=True)
    return said.stdout.splitlines()[0]


def _versions() -> dict[str, str]:
    """Of those that are installed. A library may be there without, such as jaxtwin from its
    sources."""
    found = {}
    for library in LIBRARIES:
        with suppress(PackageNotFoundError):
            found[library] = version(library)
    return found
