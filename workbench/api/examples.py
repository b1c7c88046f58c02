"""Examples of functions of the Python API, shown in their docstrings and run by a test.

Each example stands alone; `wb` is this package and `np` is numpy.
"""

EXAMPLES = {
    "calibrate": """
>>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
>>> calibration.held_out.rms_mm < calibration.nominal.rms_mm
True
>>> len(calibration.residuals.to_frame()) == calibration.samples
True
""",
    "check": """
>>> wb.check("elastic-arm").measures
'ball-centre'
""",
    "compare": """
>>> plans = wb.compare("elastic-arm", plan=["ye-mdh", "ye-2024"], folds=5).plans.to_frame()
>>> list(plans["plan"])
['ye-mdh', 'ye-2024']
""",
    "compensate": """
>>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
>>> recording = wb.load_example("elastic-arm")
>>> targets = np.rad2deg(recording.joints[:3])
>>> corrected = wb.compensate(calibration, targets).table("corrected")
>>> len(corrected)
3
""",
    "datasets": """
>>> recordings = wb.datasets().answer["datasets"]
>>> "elastic-arm" in [row["name"] for row in recordings]
True
""",
    "doctor": """
>>> checked = wb.doctor()
>>> checked.command
'doctor'
""",
    "export": """
>>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
>>> made = wb.export(calibration, "mdh-csv", "geometry.csv")
""",
    "identifiability": """
>>> stages = wb.identifiability("elastic-arm").stages.to_frame()
>>> bool((stages["identifiable"] <= stages["free"]).all())
True
""",
    "import_data": """
>>> template = wb.new("external-point", "my-robot", robot="ur10")
>>> made = wb.import_data(["my-robot/samples.csv"], out="imported", robot="ur10")
>>> made.measures
'external-point'
""",
    "new": """
>>> made = wb.new("external-point", "template", robot="ur10")
>>> wb.read("template").measures
'external-point'
""",
    "poses": """
>>> chosen = wb.poses("elastic-arm", count=20).table("poses")
>>> len(chosen)
20
""",
    "register": """
>>> points = np.random.default_rng(0).uniform(0, 500, (5, 3))
>>> for name, table in (("cad", points), ("tracker", points + [100.0, 0, 0])):
...     np.savetxt(f"{name}.csv", table, delimiter=",", header="x_mm,y_mm,z_mm", comments="")
>>> moved = wb.register("cad.csv", "tracker.csv")
>>> moved.rms_mm < 1e-3
True
""",
    "stiffness": """
>>> calibration = wb.calibrate("elastic-arm", folds=4)
>>> targets = np.array([[0.0, 20.0, 30.0, 0.0, 40.0, 0.0]])
>>> found = wb.stiffness(calibration, targets)
>>> found.compliance_largest_mm_per_n > found.compliance_least_mm_per_n > 0
True
""",
    "significance": """
>>> sensitivity = wb.significance("ur10", points=5).parameters.to_frame()
>>> sensitivity.loc[0, "parameter"]
'joint-1.theta1'
""",
}


def example(name: str) -> list[str]:
    """Lines of the docstring with the example of a function; none where it has none."""
    if name not in EXAMPLES:
        return []
    lines = EXAMPLES[name].strip().splitlines()
    return ["", "Example:", *(f"    {line}" for line in lines)]
