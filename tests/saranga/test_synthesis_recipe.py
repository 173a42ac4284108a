"""Recipes as data: what ships is valid, what is wrong is named."""

import tomllib

import pytest

from saranga.errors import UsageError
from saranga.fixtures import fixture_names, fixture_path
from saranga.synthesis import Synthesiser, load_recipe, parse_recipe


def tables() -> dict:
    return tomllib.loads(fixture_path("synthesis", "default").read_text())


@pytest.mark.parametrize("name", ["default", "paper"])
def test_shipped_recipes_load(name):
    assert name in fixture_names("synthesis")
    recipe = load_recipe(name)
    assert recipe.name == name and recipe["noise"]["psnr_db"] == (-8.0, 18.0)


def test_hash_is_of_the_values_and_not_of_the_file(tmp_path):
    text = fixture_path("synthesis", "default").read_text()
    (tmp_path / "same.toml").write_text("# other comment\n" + text)
    recipe = load_recipe("default")
    assert load_recipe(str(tmp_path / "same.toml")).sha256 == recipe.sha256
    changed = recipe.with_values({"noise.psnr_db": [-8.0, 18.5]})
    assert changed.sha256 != recipe.sha256 and recipe["noise"]["psnr_db"] == (-8.0, 18.0)


@pytest.mark.parametrize(("table", "key", "value", "words"), [
    ("noise", "psnr_db", [18, -8], r"noise.psnr_db is \[18, -8\]: low must not exceed high"),
    ("noise", "psnr_db", [-80, 5], r"noise.psnr_db is \[-80, 5\]: it must be \[low, high\] within -30..60"),
    ("noise", "psnr_db", [float("nan"), 5], r"noise.psnr_db is \[nan, 5\]"),
    ("noise", "speckle_probability", 1.5, r"noise.speckle_probability is 1.5: it must be a number in 0..1"),
    ("noise", "bank_rows", 100.5, r"noise.bank_rows is 100.5: it must be a whole number in 16..65536"),
    ("noise", "psnr_reference", "peak", r"noise.psnr_reference is 'peak': it must be one of newest, image"),
    ("noise", "pnsr_db", [0, 1], r"unknown key noise.pnsr_db \(did you mean 'psnr_db'\?\)"),
    ("obstacles", "count_weights", [1, 1], r"obstacles.count_weights is \[1, 1\]: it must be 5 weights"),
    ("obstacles", "count_weights", [0, 0, 0, 0, 0], "not all 0"),
    ("motion", "doppler", 1, r"motion.doppler is 1: it must be true or false"),
    ("recipe", "name", "", r"recipe.name is '': it must be a text"),
    ("echo", "responses", [], r"echo.responses is \[\]: it must be at least one"),
    ("echo", "responses", [{"name": "x", "taps": [[0.1, 0, 0]]}], "whose first is at 0 m"),
    ("echo", "responses", [{"name": "x", "file": "/nowhere.npz"}], "there is no such file"),
    ("paths", "arc", True, r"paths.arc is True: it must be a number"),
])
def test_a_bad_value_is_named_with_its_file_key_and_limit(table, key, value, words):
    bad = tables()
    bad[table][key] = value
    with pytest.raises(UsageError, match=words) as caught:
        parse_recipe(bad, "mine.toml")
    assert str(caught.value).startswith("mine.toml: ") and "\n" not in str(caught.value)


def test_missing_and_unknown_parts_are_named():
    for table, key, words in (("label", None, r"table \[label\] is missing"),
                              ("label", "rule", "label.rule is missing")):
        bad = tables()
        if key:
            del bad[table][key]
        else:
            del bad[table]
        with pytest.raises(UsageError, match=words):
            parse_recipe(bad, "mine.toml")
    with pytest.raises(UsageError, match=r"unknown table \[nois\] \(did you mean 'noise'\?\)"):
        parse_recipe(tables() | {"nois": {}}, "mine.toml")
    with pytest.raises(UsageError, match=r"\[kinds\] has no weight above 0"):
        parse_recipe(tables() | {"kinds": dict.fromkeys(tables()["kinds"], 0)}, "mine.toml")
    with pytest.raises(UsageError, match="must stay above 0"):
        load_recipe("paper").with_values({"cosine.b_m": [0, 0.8]})
    with pytest.raises(UsageError, match=r"unknown recipe value 'noise.psnr' \(did you mean 'noise.psnr_db'"):
        load_recipe("paper").with_values({"noise.psnr": 5})
    with pytest.raises(UsageError, match="did you mean 'default'"):
        load_recipe("defalt")


def test_sensors_and_seeds_are_checked():
    recipe = load_recipe("default")
    with pytest.raises(UsageError, match="has no 'down' sensor"):
        Synthesiser(recipe, 1, ("left", "down"))
    with pytest.raises(UsageError, match="seed is -1"):
        Synthesiser(recipe, -1)
    with pytest.raises(UsageError, match="name each wanted sensor once"):
        Synthesiser(recipe, 1, ("left", "left"))


def test_three_sensors_hear_the_elevation():
    """A point below is nearer to the lower sensor: p_L - p_D > 0, about b_V sin(elevation)."""
    recipe = load_recipe("default").with_values({
        "recipe.sonar": "triple", "obstacles.count_weights": [0, 1, 0, 0, 0], "obstacles.elevation_deg": [20, 20],
        "obstacles.azimuth_deg": [0, 0], "obstacles.range_m": [1, 1], "kinds.plane": 0, "kinds.cylinder": 0})
    made = Synthesiser(recipe, 3)
    assert made.roles == ("left", "right", "down")
    path_m = made.batch(0, 4).truth["path_m"][:, :, 0]
    assert path_m[:, 0] - path_m[:, 2] == pytest.approx(0.06 * 0.342, abs=2e-3)
    assert path_m[:, 0] == pytest.approx(path_m[:, 1], abs=1e-4)
