"""The catalogue page of the documentation."""

from conftest import ROOT
from robot_model.effects import CATALOGUE
from sensors.effects import CATALOGUE as SENSOR


def test_the_catalogue_page_has_every_effect_and_its_small_image():
    page = (ROOT / "docs" / "catalogue.md").read_text(encoding="utf-8")
    for name in {*CATALOGUE, *SENSOR}:
        assert f"### {name}\n" in page or f"- `{name}`: " in page
    images = list((ROOT / "docs" / "catalogue").glob("*.png"))
    assert page.count("](catalogue/") == len(images) > 30
    assert max(path.stat().st_size for path in images) < 40_000
