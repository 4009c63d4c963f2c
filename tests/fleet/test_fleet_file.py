"""The file of a fleet: what it says, and what is refused with the field and what is allowed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxtwin import JaxtwinError
from jaxtwin.fleet import FleetFile
from jaxtwin.fleet._fleet_file import NAME

GOOD = """
format = 1
broker = "mqtts://me:secret@broker.example/site?ca=ca.pem"
pattern = "hall/{rig}/json"

[groups.ovens]
rig = "dual-cell"
members = ["oven-{008..011}", "spare"]

[groups.cells]
rig = "single-cell"
members = ["cell"]
parameters = "fits/{rig}.toml"
sample_time_s = 2
"""


def test_groups_become_rigs_with_their_files_and_topics(tmp_path):
    (tmp_path / "fits").mkdir()
    (tmp_path / "fits" / "cell.toml").write_text("")
    path = tmp_path / "fleet.toml"
    path.write_text(GOOD)
    file = FleetFile.read(path)
    ovens = ["oven-008", "oven-009", "oven-010", "oven-011", "spare"]
    assert list(file.members) == [*ovens, "cell"]
    assert file.topic("spare", "readings") == "site/hall/spare/json/readings"
    assert file.journal == tmp_path / "fleet.db"
    cell = file.members["cell"]
    assert cell.parameters is not None
    assert cell.parameters == tmp_path / "fits" / "cell.toml"
    assert cell.sample_time == 2.0
    assert cell.files == ((str(cell.parameters), cell.parameters.stat().st_mtime_ns),)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("format = 1", "format = 2", "format: expected 1, got 2"),
        ("broker", "brokr", "unknown key 'brokr'"),
        ('"mqtts://me:secret@broker.example/site?ca=ca.pem"', '"tcp://x"', "broker: expected mqtt"),
        ("hall/{rig}/json", "hall/json", "pattern: expected levels of a topic"),
        ("hall/{rig}/json", "+/{rig}", "pattern: expected levels of a topic"),
        ('["cell"]', "[]", "groups.cells.members: expected at least 1 entries, got 0"),
        ('["cell"]', '["cell", "cell"]', "groups.cells.members: expected each rig once"),
        ('["cell"]', '["a/b"]', "groups.cells.members: expected names of letters"),
        ('["cell"]', '["a{3..1}"]', "groups.cells.members: expected a range"),
        ("sample_time_s = 2", "sample_time_s = true", "groups.cells.sample_time_s: expected"),
        ("sample_time_s = 2", 'store = "s.db"', "groups.cells.store: expected either store or"),
        ("[groups.cells]", "[groups.cells.x]", "groups.cells"),
        ("sample_time_s = 2", 'noise = "none.toml"', "groups.cells.noise: expected a file"),
    ],
)
def test_a_mistake_is_one_line_with_file_and_field(tmp_path, before, after, message):
    (tmp_path / "fits").mkdir()
    (tmp_path / "fits" / "cell.toml").write_text("")
    path = tmp_path / "fleet.toml"
    assert before in GOOD
    path.write_text(GOOD.replace(before, after, 1))
    with pytest.raises(JaxtwinError) as raised:
        FleetFile.read(path)
    text = str(raised.value)
    assert text.startswith(str(path))
    assert message in text
    assert "secret" not in text
    assert "\n" not in text


@given(st.text(max_size=20))
def test_names_are_safe_in_topics_addresses_and_labels(text):
    if NAME.fullmatch(text):
        assert not set(text) & set('/+#?&"\\ \n%{}')
        assert text not in (".", "..")
