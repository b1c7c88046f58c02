"""Pages of the gallery are not stale: what takes minutes is computed again and compared."""

import os
import shutil
import subprocess
import sys

import pytest

from conftest import ROOT

sys.path.insert(0, str(ROOT / "tools"))

from gallery import PAGES
from tutorial_output import text_difference

COMPUTED = (
    pytest.param("laser-spot", marks=pytest.mark.slow),
    pytest.param("partial-pose", marks=pytest.mark.slow),
    pytest.param("touch-point", marks=pytest.mark.long),
)
"""Those whose figures take a minute of processor time, and one of two minutes."""


@pytest.mark.parametrize("name", COMPUTED)
def test_a_page_says_what_is_computed_now(name, tmp_path):
    assert name in PAGES
    for part in ("tools", "docs"):
        shutil.copytree(ROOT / part, tmp_path / part)
    page = tmp_path / "docs" / "gallery" / f"{name}.md"
    before = page.read_text(encoding="utf-8")
    page.unlink()
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = [sys.executable, str(tmp_path / "tools" / "gallery.py"), name]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = text_difference(before, page.read_text(encoding="utf-8"))
    assert found is None, f"{found}; run `python tools/gallery.py {name}`"
