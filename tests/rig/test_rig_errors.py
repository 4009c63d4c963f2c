"""Every mistake in a rig file gets one error: file, field, what was expected, what was found.

Each case takes a bundled file, replaces one text in it and loads the result.
"""
# ruff: noqa: E501  (a table of cases reads best with one case a line)

import pytest

from jaxtwin.data import data_folder
from jaxtwin.errors import RigError
from jaxtwin.rig import load_rig

# id: (bundled rig, text that stands in it, text in its place, field, what else the message says)
MISTAKES = {
    "unknown key": ("paper", "thickness =", "thicknes =", "plate", "'thicknes'", "did you mean 'thickness'"),
    "unknown table": ("paper", "[driver]", "[drivers]", "", "'drivers'", "did you mean 'driver'"),
    "unknown key of a link": ("paper", "factor = 2.0", "faktor = 2.0", "circuit.links[R_Tez]", "'faktor'", "did you mean 'factor'"),
    "missing key": ("paper", 'capacitance = "C_element"', "", "circuit.capacitance", "missing"),
    "missing table": ("paper", '[ambient]\ntemperature = "T_amb"', "", "ambient", "missing"),
    "a format that is no number": ("paper", "format = 1", "format = true", "format", "expected a whole number", "got true"),
    "a polarity that is no number": ("dual", "polarity = 1", "polarity = true", "driver.polarity", "expected a whole number", "got true"),
    "another format": ("paper", "format = 1", "format = 2", "format", "expected 1", "got 2"),
    "a mass for a length": ("paper", '"5.08 mm"', '"4 kg"', "plate.thickness", "'4 kg'", "a length above 0"),
    "no unit": ("paper", '"1.5 cm"', '"1.5"', "plate.columns[8]", "'1.5'", "without a unit", "4 cm"),
    "a number for a quantity": ("paper", '"5.08 mm"', "5.08", "plate.thickness", "5.08", "a number with its unit"),
    "unknown unit": ("paper", '"5.08 mm"', '"5.08 furlongz"', "plate.thickness", "'furlongz'", "a length"),
    "a power tower for a unit": ("paper", '"5.08 mm"', '"5.08 m**9**9**9"', "plate.thickness", "not a known unit"),
    "neither number nor name": ("paper", '"12 V"', '"twelve V"', "driver.supply_voltage", "'twelve V'", "a voltage"),
    "degC for a difference": ("paper", '"0.1 K"', '"0.1 degC"', "camera.noise", "point on a scale", "0.1 K"),
    "degF": ("paper", '"298 K"', '"77 degF"', "cells[P1].initial_temperature", "'degF'", "only degC may"),
    "below absolute zero": ("paper", '"298 K"', '"-300 degC"', "cells[P1].initial_temperature", "above 0 K"),
    "a number that is not finite": ("paper", '"12 V"', '"1e999 V"', "driver.supply_voltage", "finite"),
    "a number without sense": ("paper", '"13.5 g"', '"1e200 kg"', "cells[P1].side_mass", "1e+30"),
    "a sink of no resistance": ("paper", 'sink_resistance = "R_ph"', 'sink_resistance = "0 K/W"', "cells[P1].sink_resistance", "'0 K/W'", "above 0"),
    "a negative thickness": ("paper", '"5.08 mm"', '"-1 mm"', "plate.thickness", "'-1 mm'", "above 0"),
    "a negative on-resistance": ("paper", '"0.1 ohm"', '"-0.1 ohm"', "driver.on_resistance", "of at least 0"),
    "a capacitance that may reach zero": ("paper", 'description = "every', 'bounds = [0.0, 99.0], description = "every', "circuit.capacitance", "got 0 J/K as the lower bound of 'C_element'", "above 0"),
    "a resistance that is negative": ("paper", "R_Tfx1 = { value = 0.3068117108802796", "R_Tfx1 = { value = -0.3", "circuit.links[R_Tfx1].resistance", "got -0.3 K/W as the value of 'R_Tfx1'", "above 0"),
    "a resistance that is zero in a set": ("paper", "R_Tfx1 = 0.3068117108802796", "R_Tfx1 = 0.0", "circuit.links[R_Tfx1].resistance", "parameter set 'startup'", "above 0"),
    "a negative factor": ("paper", "factor = 2.0", "factor = -2.0", "circuit.links[R_Tez].factor", "-2.0", "greater than 0"),
    "unknown parameter": ("paper", 'sink_resistance = "R_ph"', 'sink_resistance = "R_pq"', "cells[P1].sink_resistance", "'R_pq'", "did you mean 'R_p"),
    "a parameter of another kind": ("paper", 'sink_resistance = "R_ph"', 'sink_resistance = "R_E"', "cells[P1].sink_resistance", "'R_E'", "'ohm'", "a thermal resistance"),
    "a parameter that nothing uses": ("paper", "[parameters]\n", '[parameters]\nR_Tex3 = { value = 1.0, unit = "K/W" }\n', "parameters.R_Tex3", "nothing uses"),
    "a parameter with a bad name": ("paper", "[parameters]\n", '[parameters]\n"R Tex3" = { value = 1.0, unit = "K/W" }\n', "parameters.R Tex3", "letters, digits"),
    "a parameter without unit": ("paper", "value = 0.6, unit = \"K/W\"", "value = 0.6", "parameters.R_ph.unit", "missing"),
    "a parameter with an unknown unit": ("paper", "value = 0.6, unit = \"K/W\"", 'value = 0.6, unit = "K/Wat"', "parameters.R_ph.unit", "'K/Wat'"),
    "a parameter that is text": ("paper", "value = 0.6,", 'value = "0.6",', "parameters.R_ph.value", "'0.6'", "a valid number"),
    "a parameter that is no number": ("paper", "value = 0.6,", "value = nan,", "parameters.R_ph.value", "nan", "finite"),
    "an unknown scope": ("paper", 'scope = "recording"', 'scope = "recordings"', "parameters.T_amb.scope", "'recordings'", "'shared', 'group' or 'recording'"),
    "bounds that exclude the value": ("paper", "bounds = [2e-06, 2.0], free = true, description = \"far", "bounds = [1.0, 2.0], free = true, description = \"far", "parameters.R_ph.value", "got 0.6", "1 to 2"),
    "bounds the wrong way": ("paper", "bounds = [0.0, 40.0]", "bounds = [40.0, 0.0]", "parameters.T_amb.bounds", "[40, 0]", "lower below upper"),
    "three bounds": ("paper", "bounds = [0.0, 40.0]", "bounds = [0.0, 20.0, 40.0]", "parameters.T_amb.bounds", "at most 2"),
    "a set with an unknown name": ("paper", "R_Th = 9.75", "R_TH = 9.75", "parameter_sets.published.R_TH", "did you mean 'R_Th'"),
    "a set out of bounds": ("paper", "R_Th = 9.75", "R_Th = 12.5", "parameter_sets.published.R_Th", "got 12.5", "1.2e-05 to 12"),
    "a link to an unknown element": ("paper", '"V11-V12"', '"V11-V19"', "circuit.links[R_Tfx1].between", "'V19'", "V11 to V38"),
    "a link to itself": ("paper", '"V11-V12"', '"V11-V11"', "circuit.links[R_Tfx1].between", "'V11-V11'", "two different nodes"),
    "a link with one end": ("paper", '"V11-V12"', '"V11"', "circuit.links[R_Tfx1].between", "'V11'", '"V11-V12"'),
    "a cell on no element": ("paper", "contacts = { V23", "contacts = { V43", "cells[P1].contacts", "'V43'", "V11 to V38"),
    "a cell larger than its elements": ("dual", 'contacts = { V12', 'area = "65 cm^2"\ncontacts = { V12', "cells[P1].area", "at most 64 cm^2"),
    "an area beside a circuit": ("paper", 'contacts = { V23 = "R_pc" }', 'contacts = { V23 = "R_pc" }\narea = "16 cm^2"', "cells[P1].area", "none beside a [circuit]"),
    "a cell without contact": ("paper", 'contacts = { V23 = "R_pc" }', "contacts = {}", "cells[P1].contacts", "at least 1"),
    "two cells of one name": ("paper", 'name = "P2"', 'name = "P1"', "cells", "'P1' twice"),
    "a channel that no recording can hold": ("paper", 'name = "T12"', 'name = "T,12"', "channels[T,12].name", "'T,12'", "letters, digits"),
    "a channel called as the room is": ("paper", 'name = "T12"', 'name = "ambient"', "channels[ambient].name", "not 'ambient'"),
    "a name on two lines": ("paper", 'name = "paper-2024"', 'name = """paper\n2024"""', "name", "text on one line"),
    "two channels of one name": ("paper", 'name = "T12"', 'name = "T11"', "channels", "'T11' twice"),
    "a channel on no element": ("paper", 'nodes = ["V38"]', 'nodes = ["V48"]', "channels[T26].nodes", "'V48'"),
    "a channel with an element twice": ("paper", '["V24", "V25"]', '["V24", "V24"]', "channels[TBM].nodes", "'V24' twice"),
    "a channel without elements": ("paper", 'nodes = ["V38"]', "nodes = []", "channels[T26].nodes", "at least 1"),
    "a channel without place": ("paper", 'nodes = ["V38"]', 'x = ["1 cm", "2 cm"]', "channels[T26]", "either nodes or x with y"),
    "circuit and materials": ("paper", 'thickness = "5.08 mm"', 'thickness = "5.08 mm"\ndensity = "8960 kg/m^3"', "plate.density", "either this or [circuit]"),
    "neither circuit nor materials": ("dual", 'density = "8960 kg/m^3"\n', "", "plate.density", "got neither", "[circuit] or all of"),
    "unknown material": ("printer", 'material = "aluminium"', 'material = "alumnium"', "plate.material", "'alumnium'", "did you mean 'aluminium'"),
    "a material that is not on one line": ("printer", 'material = "aluminium"', 'material = ""', "plate.material", "text on one line"),
    "a material alone": ("printer", 'film_coefficient = "h"\n', "", "plate.film_coefficient", "a value beside the material", "got none"),
    "a circuit and a material": ("paper", 'thickness = "5.08 mm"', 'thickness = "5.08 mm"\nmaterial = "copper"', "plate.material", "either this or [circuit]"),
    "a limit of the rate that is never kept": ("paper", 'temperature = "90 degC"', 'temperature = "90 degC"\nrate = "0 K/s"', "limits.rate", "expected a rate above 0", "'0 K/s'"),
    "a lowest temperature above the limit": ("paper", 'temperature = "90 degC"', 'temperature = "90 degC"\nlowest = "90 degC"', "limits.lowest", "expected a temperature below limits.temperature", "'90 degC'"),
    "a zone outside the plate": ("dual", '"25.5 cm"', '"26 cm"', "channels[T16].x", "'26 cm'", "0 to 25.5 cm"),
    "a zone of no size": ("dual", '["5.25 cm", "6.25 cm"]', '["6.25 cm", "6.25 cm"]', "channels[TAM].y", "a range inside the plate"),
    "too few film coefficients": ("dual", '["h_A", "h_A", "h_A",', '["h_A",', "plate.film_coefficient", "expected 8 values", "got 6"),
    "too many row factors": ("dual", '["f_row1", "1", "f_row3"]', '["f_row1", "1", "1", "f_row3"]', "plate.film_row_factor", "expected 3 values", "got 4"),
    "a row factor with a unit": ("dual", '["f_row1", "1", "f_row3"]', '["f_row1", "1 cm", "f_row3"]', "plate.film_row_factor[2]", "'1 cm'", "a number"),
    "unknown module": ("dual", 'module = "TEC1-12706"', 'module = "TEC1-1206"', "cells[P1].module", "did you mean 'TEC1-12706'"),
    "a sink with half its values": ("dual", 'sink_air_resistance = "R_sink1"\n', "", "cells[P1]", "both or neither of sink_capacitance"),
    "two capacitances of a side": ("dual", 'side_capacitance = "C_side"', 'side_capacitance = "C_side"\nside_mass = "1 g"', "cells[P1]", "either side_capacitance or side_mass"),
    "a mass without its specific heat": ("paper", 'side_specific_heat = "C_esp"\n', "", "cells[P1]", "either side_capacitance or side_mass"),
    "a constant that nothing gives": ("paper", 'electrical_resistance = "R_E"\n', "", "cells[P1].electrical_resistance", "name a module"),
    "an open bridge with voltage averaging": ("paper", 'averaging = "voltage"', 'averaging = "voltage"\noff_phase = "open"', "driver.off_phase", "'open'", '"brake"'),
    "unknown averaging": ("paper", 'averaging = "voltage"', 'averaging = "mean"', "driver.averaging", "'mean'", "'voltage' or 'on-off'"),
    "polarity of zero": ("paper", "polarity = 1", "polarity = 0", "driver.polarity", "got 0", "1 or -1"),
    "no counts": ("paper", "counts = 255", "counts = 0", "driver.counts", "got 0"),
    "a view outside the frame": ("paper", "x = [0, 80]", "x = [0, 81]", "camera.view.x", "81", "0 to 80"),
    "a resolution of three numbers": ("paper", "[80, 60]", "[80, 60, 3]", "camera.resolution", "at most 2"),
}  # fmt: skip


def bundled_text(short: str) -> str:
    name = {"paper": "paper-2024", "dual": "dual-cell", "printer": "printer-bed"}[short]
    return (data_folder() / "rigs" / f"{name}.toml").read_text("utf-8")


@pytest.mark.parametrize("mistake", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_told_with_file_field_and_what_is_allowed(mistake, tmp_path):
    short, old, new, field, *fragments = mistake
    text = bundled_text(short)
    assert old in text
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(old, new, 1), "utf-8")
    with pytest.raises(RigError) as caught:
        load_rig(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: {field}: " if field else f"{path}: ")
    for fragment in fragments:
        assert fragment in message
    assert "\n" not in message
    assert len(message) < 500
    assert caught.value.__suppress_context__, "one clear error, without those behind it"


def test_an_element_without_a_path_to_the_surroundings_is_named(tmp_path):
    """V11 keeps its capacitance but loses all five of its links."""
    text = bundled_text("paper")
    for link in ('"V11-V12", ', '"V11-V21", ', '"V11-ambient", '):
        assert link in text
        text = text.replace(link, "")
    path = tmp_path / "mine.toml"
    path.write_text(text, "utf-8")
    with pytest.raises(RigError, match='a path from each node to "ambient", got none from V11'):
        load_rig(path)


def test_elements_that_only_a_cell_connects_are_accepted(tmp_path):
    """The cell's sink is a path to the surroundings."""
    text = bundled_text("paper")
    path = tmp_path / "mine.toml"
    path.write_text(text.replace('"V23-ambient", ', ""), "utf-8")
    assert load_rig(path).circuit is not None


def test_bad_toml_is_told_with_its_line(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('format = 1\nname = "x\n', "utf-8")
    with pytest.raises(RigError, match=r"mine\.toml: no valid TOML: .*line 2"):
        load_rig(path)


def test_text_that_is_not_utf8_is_told_with_its_line(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_bytes(b'format = 1\nname = "\xff"\n')
    with pytest.raises(RigError, match=r"mine\.toml: line 2: expected TOML in UTF-8"):
        load_rig(path)


def test_a_byte_order_mark_before_the_text_is_no_mistake(tmp_path):
    """As Notepad and PowerShell write it."""
    text = load_rig("tclab").text
    path = tmp_path / "tclab.toml"
    path.write_bytes(b"\xef\xbb\xbf" + text.encode())
    assert load_rig(path).text == text
    assert load_rig(path).parameters == load_rig("tclab").parameters


def test_a_room_that_is_none_is_refused(tmp_path):
    """20 degC with the unit K."""
    text = load_rig("tclab").text.replace('temperature = "T_amb"', 'temperature = "20 K"')
    path = tmp_path / "tclab.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(RigError, match=r"ambient.temperature: .* got -253.15 degC, which is 20 K"):
        load_rig(path)


def test_a_missing_file_lists_the_bundled_rigs(tmp_path):
    with pytest.raises(RigError, match=r"no\.toml: no such file, .*dual-cell, .*paper-2024"):
        load_rig(tmp_path / "no.toml")


def test_a_saved_fit_in_place_of_a_rig_file_is_called_one(tmp_path):
    path = tmp_path / "fit.toml"
    path.write_text('rig = "dual-cell"\n[parameters]\nR_E = { value = 2.2, unit = "ohm" }\n')
    with pytest.raises(
        RigError, match=r"fit\.toml: expected a rig file, got a parameter file.*Twin"
    ):
        load_rig(path)


def test_a_folder_is_no_rig_file(tmp_path):
    with pytest.raises(RigError, match="cannot be read"):
        load_rig(tmp_path)


def test_a_name_nearly_that_of_a_bundled_rig_is_suggested():
    with pytest.raises(RigError, match="did you mean 'paper-2024'"):
        load_rig("paper2024")
