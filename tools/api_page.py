"""Writes docs/reference/api.md from the Python API itself: signature and docstring of every public name.

Run by `make docs`; the page is not kept in the repository.
"""

import inspect
import typing
from pathlib import Path

import workbench

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "api.md"
HEAD = """# Python API

![A Python session: held-out error, parameters and residuals](../images/api.svg)

```python
import workbench as wb

recording = wb.load_example("elastic-arm")          # or wb.read("folder")
calibration = wb.calibrate(recording)
calibration.held_out.rms_mm                         # every entry of the answer is an attribute
calibration.parameters.to_frame()                   # pandas
calibration.residuals.to_frame()
calibration.report("page.html")

diagnosis = wb.diagnose(recording)
diagnosis.model.compensate("targets.csv").table("corrected")
calibration.export("arm.urdf")
calibration.save("my-run")                          # wb.load("my-run") reads it back
```

From arrays:

```python
recording = wb.Recording.from_arrays(
    robot="ur10", joints_deg=q, points_mm=p, sigma_mm=0.02, temperature_c=t
)
```

Every command but `open` has a function. It runs the command in a temporary folder, or in `out`, and returns a
`Result`. A wrong input raises `InputError` with the sentence of the command line.

"""


def page() -> str:
    """The page as Markdown."""
    parts = [HEAD]
    for name in workbench.__all__:
        if name.startswith("__"):
            continue
        value = getattr(workbench, name)
        parts.append(section(name, value))
    return "\n".join(parts)


def section(name: str, value) -> str:
    """Heading, signature and docstring of one public name."""
    lines = [f"## `{name}`", "", "```python", f"{name}{_signature(value)}", "```", ""]
    lines += [inspect.getdoc(value) or "", ""]
    if inspect.isclass(value):
        for key, member in vars(value).items():
            if not key.startswith("_") and inspect.getdoc(member):
                summary = inspect.getdoc(member).splitlines()[0]
                lines.append(f"- `{key}`: {summary}")
        lines.append("")
    return "\n".join(lines)


def _signature(value) -> str:
    try:
        signature = inspect.signature(value)
    except (TypeError, ValueError):
        return ""
    plain = [p.replace(annotation=_type(p.annotation)) for p in signature.parameters.values()]
    return str(signature.replace(parameters=plain, return_annotation=inspect.Signature.empty))


def _type(annotation):
    if typing.get_origin(annotation) is typing.Annotated:
        return typing.get_args(annotation)[0]
    return annotation


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(f"{PAGE.name} written")
