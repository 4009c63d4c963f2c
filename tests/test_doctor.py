"""What `jaxtwin doctor` finds is what is there."""

import jax
import numpy as np

import jaxtwin
from jaxtwin.cli import run
from jaxtwin.doctor import examine


def test_versions_are_those_of_the_libraries():
    versions = examine()["versions"]
    assert versions["jaxtwin"] == jaxtwin.__version__
    assert versions["jax"] == jax.__version__
    assert versions["numpy"] == np.__version__


def test_it_says_which_devices_jax_has_and_who_turns_float64_on():
    found = examine()["jax"]
    assert found["devices"].startswith(jax.devices()[0].platform)
    assert found["float64 by default"].startswith("off")


def test_settings_of_threads_are_those_of_the_environment(monkeypatch):
    for name in ("OMP_NUM_THREADS", "PJRT_NPROC", "XLA_FLAGS"):
        monkeypatch.delenv(name, raising=False)
    assert examine()["machine"]["thread settings"] == "none"
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    assert examine()["machine"]["thread settings"] == "OMP_NUM_THREADS=2"


def test_usable_cores_are_those_of_this_process(monkeypatch):
    """For the system, process 0 is the calling one."""
    cores = {0: {0, 2, 3}, 1: {0}}
    monkeypatch.setattr("os.sched_getaffinity", cores.__getitem__, raising=False)
    assert examine()["machine"]["CPU cores"].endswith(", 3 of them usable by this process")


def test_recordings_are_named_or_it_says_where_they_were_looked_for(tmp_path, monkeypatch):
    monkeypatch.setenv("JAXTWIN_RECORDINGS", str(tmp_path))
    assert f"looked in: {tmp_path}" in examine()["recordings"]["two cells"]


def test_the_cache_can_be_turned_off(monkeypatch):
    monkeypatch.setenv("JAXTWIN_COMPILATION_CACHE", "off")
    found = examine()["compiled programs"]
    assert found.keys() == {"state", "many draws"}
    assert found["state"] == "off by JAXTWIN_COMPILATION_CACHE"


def test_it_says_what_solves_many_draws(monkeypatch):
    monkeypatch.setenv("JAXTWIN_NATIVE", "off")
    assert examine()["compiled programs"]["many draws"] == "by JAX; C is off by JAXTWIN_NATIVE"


def test_it_prints_every_finding(capsys):
    assert run(["doctor"]) == 0
    text = capsys.readouterr().out
    for section, entries in examine().items():
        assert section in text
        assert all(name in text for name in entries)
