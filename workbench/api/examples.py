"""Examples of functions of the Python API, shown in their docstrings and run by a test.

Each example stands alone, in an empty folder; `wb` is this package and `np` is numpy.
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
>>> checks = wb.doctor().checks.to_frame()
>>> bool(checks.loc[checks["name"] == "Python", "ok"].all())
True
""",
    "evaluate": """
>>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
>>> evaluated = wb.evaluate(calibration, "elastic-arm", refit="base-and-tool")
>>> evaluated.error.rms_mm < evaluated.nominal.rms_mm
True
""",
    "export": """
>>> calibration = wb.calibrate("elastic-arm", plan="ye-mdh", folds=4)
>>> made = wb.export(calibration, "mdh-csv", "geometry.csv")
>>> len(open("geometry.csv").readlines())
7
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
>>> import pandas
>>> table = pandas.read_csv("my-robot/samples.csv")
>>> wb.import_data([table], out="from-frame", robot="ur10").samples
36
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
>>> wb.register(points, points + [0.0, 0.0, 5.0]).rms_mm < 1e-3
True
""",
    "stiffness": """
>>> calibration = wb.calibrate("elastic-arm")
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
    "calibrate_large": """
>>> import pathlib
>>> template = wb.new("external-point", "big", robot="ur10")
>>> rows = wb.read("big").columns
>>> import pandas
>>> pandas.DataFrame(rows).to_parquet("big/samples.parquet")
>>> described = pathlib.Path("big/recording.toml")
>>> text = described.read_text().replace("samples.csv", "samples.parquet")
>>> length = described.write_text(text)
>>> calibration = wb.calibrate_large("big", folds=4)
>>> calibration.held_out.rms_mm < calibration.nominal.rms_mm
True
""",
    "camera": """
>>> template = wb.new("board-images", "my-camera")
>>> camera = wb.camera("my-camera")
>>> camera.held_out.rms_px < 0.2
True
>>> len(camera.images.to_frame())
14
""",
    "demo": """
>>> shown = wb.demo(bundled=True, images=False)
>>> shown.held_out.rms_mm < shown.nominal.rms_mm
True
""",
    "diagnose": """
>>> template = wb.new("external-point", "my-robot", robot="ur10")
>>> diagnosis = wb.diagnose("my-robot")
>>> diagnosis.answer["verdict"], len(diagnosis.answer["effects"])
('consistent', 0)
""",
    "hand_eye": """
>>> template = wb.new("board-images", "my-hand-eye")
>>> found = wb.hand_eye("my-hand-eye")
>>> found.transform, np.shape(found.hand_eye.matrix)
('T_flange_sensor', (4, 4))
""",
    "prove": """
>>> board = wb.prove(suite=["clean=1"], seed=53, out="benchmark")
>>> board.cases
1
""",
    "render": """
>>> scene = '''
... camera = { width_px = 320, height_px = 240, fx_px = 500, fy_px = 500, cx_px = 160, cy_px = 120 }
... balls = [[0.0, 0.0, 0.0, 10.0]]
... scans = { count = 1 }
... placements = { count = 2, laser = 1 }
... mirror = { steps = 2 }
... '''
>>> with open("scene.toml", "w") as file:
...     length = file.write(scene)
>>> rendered = wb.render("scene.toml", out="rendered")
>>> wb.read("rendered").measures
'scan-images'
""",
    "scan": """
>>> template = wb.new("profiler", "my-profiler")
>>> scans = wb.scan("my-profiler").scans
>>> scans[0].balls[0].radius_mm > 0
True
""",
    "scanner": """
>>> template = wb.new("fixed-plane", "my-scanner")
>>> scanner = wb.scanner("my-scanner")
>>> len(scanner.planes), scanner.planes[0].rms_mm < 0.1
(1, True)
""",
    "simulate": """
>>> scene = 'robot = "ur10"\\nmeasures = "external-point"\\nsamples = 20\\nsigma_mm = 0.02\\n'
>>> with open("scene.toml", "w") as file:
...     length = file.write(scene)
>>> made = wb.simulate("scene.toml", out="simulated")
>>> wb.read("simulated").points.shape
(20, 3)
""",
    "study": """
>>> study = '''
... kind = "uncertainty"
... recording = "elastic-arm"
... do = ["calibrate"]
... models = ["geometry"]
... folds = 2
... resample = { how = "noise" }
... vary = { runs = 2 }
... '''
>>> with open("study.toml", "w") as file:
...     length = file.write(study)
>>> repeated = wb.study("study.toml", out="repeated")
>>> repeated.done, repeated.outcome
(2, 'geometry_held_out_mm')
""",
}


def example(name: str) -> list[str]:
    """Lines of the docstring with the example of a function."""
    lines = EXAMPLES[name].strip().splitlines()
    return ["", "Examples:", *(f"    {line}" for line in lines)]
