"""What the package contains, the lock file, and the bill of materials."""

import json
import re
import sys
import tomllib

from conftest import ROOT

sys.path.insert(0, str(ROOT / "tools"))

import sbom  # noqa: E402

LOCKS = (ROOT / "requirements.lock", ROOT / "requirements-torch.lock")


def test_every_required_dependency_is_locked_with_a_hash():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    text = "\n".join(path.read_text(encoding="utf-8") for path in LOCKS)
    entries = re.split(r"\n(?=[a-z])", text)
    pinned = [(re.match(r"([a-z0-9.-]+)==", entry), entry) for entry in entries]
    locked = {match[1]: entry for match, entry in pinned if match}
    assert all("--hash=sha256:" in entry for entry in locked.values())
    wanted = [line for line in project["dependencies"] if "sys_platform != 'linux'" not in line]
    names = {re.match(r"[A-Za-z0-9_-]+", line)[0].lower() for line in wanted}
    assert names <= set(locked)


def test_no_place_of_one_machine_stands_in_the_lock():
    for path in LOCKS:
        assert not re.search(r"(^|\s)(file:|/)", path.read_text(encoding="utf-8"))


def test_the_bill_of_materials_holds_every_installed_dependency(tmp_path):
    sbom.main(tmp_path)
    bill = json.loads((tmp_path / "sbom.cdx.json").read_text(encoding="utf-8"))
    names = {component["name"] for component in bill["components"]}
    assert bill["bomFormat"] == "CycloneDX" and bill["specVersion"] == "1.5"
    assert {"numpy", "scipy", "torch", "pydantic", "typing-extensions"} <= names
    assert all(component["purl"].startswith("pkg:pypi/") for component in bill["components"])
    lines = (tmp_path / "licences.csv").read_text(encoding="utf-8").splitlines()
    assert lines[0] == "name,version,licence,home" and len(lines) > len(names)
