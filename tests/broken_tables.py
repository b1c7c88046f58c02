"""Every known way to break the tables of a recording, and the sentence that it must get."""

from broken_recordings import (
    ART,
    CSV,
    TOML,
    Case,
    Q,
    add,
    both,
    cell,
    column,
    drop,
    effect_indices,
    every_line,
    parquet,
    radians,
    remove,
    sub,
    ten_gigabytes,
    thousandth,
    write,
)

TABLES = [
    # samples.csv, the table
    Case("no samples.csv", remove(CSV), (CSV, "no such file", "put it there")),
    Case("empty samples.csv", write(CSV, b""), (CSV, "empty file", "export it again")),
    Case(
        "only a header",
        every_line(lambda t: t.splitlines()[0]),
        (CSV, "at least one row", "record samples"),
    ),
    Case("only blanks", write(CSV, b" , \n\n"), (CSV, "header row", "export it again")),
    Case("ten gigabytes", ten_gigabytes, (CSV, "at most 256 MB", "10000 MB", "split")),
    Case(
        "UTF-16",
        every_line(lambda t: t)
        and (lambda f: bool((f / CSV).write_bytes((f / CSV).read_text().encode("utf-16")))),
        (CSV, "byte 1", "UTF-8"),
    ),
    Case(
        "semicolons",
        every_line(lambda t: t.replace(",", ";")),
        (CSV, "row 1", "semicolons", "comma delimited"),
    ),
    Case(
        "European spreadsheet",
        every_line(lambda t: t.replace(",", ";").replace(".", ",")),
        (CSV, "row", "semicolons", "decimal point"),
    ),
    Case(
        "tabs",
        every_line(lambda t: t.replace(",", "\t")),
        (CSV, "row 1", "tabs", "comma delimited"),
    ),
    Case(
        "unclosed quote", sub(CSV, r"^1,", '"1,'), (CSV, "row 2", "breaks off", "export it again")
    ),
    Case("NUL byte", sub(CSV, r"^1,", "\0001,"), (CSV, "row 2", "column sample", "correct it")),
    Case(
        "duplicate column",
        column("q2_deg", str, "q1_deg"),
        (CSV, "row 1", "column q1_deg", "rename"),
    ),
    Case(
        "column without a name",
        column("time_s", str, " "),
        (CSV, "row 1", "column name", "name the column"),
    ),
    Case("row too long", sub(CSV, r"^2,", "2,7,"), (CSV, "row 3", "cells", "decimal point")),
    Case("row too short", sub(CSV, r"^2,", ""), (CSV, "row 3", "cells", "fill")),
    Case(
        "word for a number", cell(4, "q3_deg", "abc"), (CSV, "row 4", "q3_deg", "'abc'", "correct")
    ),
    Case(
        "quote in the middle",
        sub(CSV, r"^2,([-\d]+)\.", r'2,"\1,"'),
        (CSV, "row 3", "breaks off", "quotes"),
    ),
    Case(
        "quoted decimal comma",
        sub(CSV, r"^2,([-\d]+)\.(\d+)", r'2,"\1,\2"'),
        (CSV, "row 3", "q1_deg", "decimal comma", "write a point"),
    ),
    Case("empty cell", cell(5, "x_mm", ""), (CSV, "row 5", "x_mm", "empty cell", "fill it")),
    Case("NaN", cell(5, "x_mm", "nan"), (CSV, "row 5", "(sample 4)", "x_mm", "nan", "correct")),
    Case(
        "infinity",
        cell(6, "temperature_c", "-inf"),
        (CSV, "row 6", "temperature_c", "inf", "correct"),
    ),
    Case("absurd number", cell(6, "y_mm", "1e40"), (CSV, "row 6", "y_mm", "finite", "correct")),
    Case("unknown text column", add("operator", "Ann"), (CSV, "row 2", "operator", "note")),
    # samples.csv, what the kind needs
    Case("no sample column", drop("sample"), (CSV, "column sample", "add it")),
    Case("no ball column", drop("ball"), (CSV, "column ball", "add it")),
    Case("no z", drop("z_mm"), (CSV, "column z_mm", "add it")),
    Case(
        "points named in metres",
        column("([xyz])_mm", thousandth, r"\1_m"),
        (CSV, "column x_mm", "x_m", "rename"),
    ),
    Case("no point column", drop("point"), (CSV, "column point", "add it"), "touch-point"),
    Case("no sphere column", drop("sphere"), (CSV, "column sphere", "add it"), "laser-spot"),
    Case("no length", drop("length_mm"), (CSV, "column length_mm", "add it"), "distance"),
    Case("no plane", drop("plane"), (CSV, "column plane", "add it"), "plane-touch"),
    Case("no quaternion", drop("qw"), (CSV, "column qw", "add it"), "external-pose"),
    Case("half an axis", drop("nz"), (CSV, "nx ny nz", "neither", "add"), "partial-pose"),
    Case(
        "no joints",
        both(*(drop(f"q{k}_deg") for k in range(1, 7))),
        (CSV, "q1_deg", "none", "add them"),
    ),
    Case(
        "joints named in radians",
        column("(q.)_deg", radians, r"\1_rad"),
        (CSV, "q1_rad", "rename it to q1_deg"),
    ),
    Case("gap in the joints", drop("q4_deg"), (CSV, "q4_deg", "add the missing joint")),
    Case(
        "too few joints",
        drop("q6_deg"),
        (CSV, "q5_deg", "6 joints", "5 joint columns", "robot file"),
    ),
    Case(
        "too many joints",
        add("q7_deg", "0"),
        (CSV, "q7_deg", "6 joints", "7 joint columns", "robot file"),
    ),
    Case("millimetres for degrees", column("q6_deg", str, "q6_mm"), (CSV, "q6_mm", "deg", "kind")),
    # samples.csv, values
    Case(
        "sample not whole", cell(3, "sample", "2.5"), (CSV, "row 3", "sample", "2.5", "number them")
    ),
    Case(
        "duplicate sample",
        cell(7, "sample", "2"),
        (CSV, "row 7", "sample", "first in row 3", "another number"),
    ),
    Case("ball not whole", cell(3, "ball", "1.5"), (CSV, "row 3", "ball", "1.5", "number them")),
    Case(
        "reflector not whole",
        add("reflector", "1.2"),
        (CSV, "row 2", "reflector", "1.2", "number them"),
    ),
    Case("pose not whole", cell(3, "pose", "0.1"), (CSV, "row 3", "pose", "0.1", "number them")),
    Case(
        "unknown ball", cell(3, "ball", "9"), (CSV, "row 3", "ball", "(1, 2, 3, 4)", "add the ball")
    ),
    Case(
        "approach is a speed",
        cell(3, "approach1", "0.5"),
        (CSV, "row 3", "approach1", "-1, 0 or 1", "sign"),
    ),
    Case(
        "fixed to the ceiling",
        add("fixed_to", "ceiling"),
        (CSV, "row 2", "fixed_to", "'ceiling'", "write one"),
    ),
    Case("nothing on the tool", add("fixed_to", "base"), (CSV, "fixed_to", "none", "add the rows")),
    Case(
        "row sigma zero",
        add("sigma_mm", "0"),
        (CSV, "row 2", "sigma_mm", "above 0", "delete the column"),
    ),
    Case(
        "length zero",
        cell(4, "length_mm", "0"),
        (CSV, "row 4", "length_mm", "above 0", "correct"),
        "distance",
    ),
    Case(
        "pair of one", cell(4, "pair", "77"), (CSV, "pair", "two rows", "same number"), "distance"
    ),
    Case(
        "points touched once",
        effect_indices("point"),
        (CSV, "row 2", "point", "same number"),
        "touch-point",
    ),
    Case(
        "quaternion not unit",
        cell(4, "qw", "0.9"),
        (CSV, "row 4", "qw qx qy qz", "length 1", "divide"),
        "external-pose",
    ),
    Case(
        "axis not unit",
        cell(4, "nx", "0.9"),
        (CSV, "row 4", "nx ny nz", "length 1", "divide"),
        "partial-pose",
    ),
    # samples.csv, what cannot be
    Case("radians for degrees", column(Q, radians), (CSV, "q1_deg", "radians", "57.29578")),
    Case(
        "radians, touched points",
        column(Q, radians),
        (CSV, "q1_deg", "radians", "57.29578"),
        "touch-point",
    ),
    Case(
        "radians, outside",
        column(Q, radians),
        (CSV, "q1_deg", "radians", "57.29578"),
        "external-point",
    ),
    Case(
        "metres, outside",
        column("[xyz]_mm", thousandth),
        (CSV, "x_mm, y_mm, z_mm", "metres", "1000"),
        "external-point",
    ),
    Case(
        "metres, a ball",
        column("[xyz]_mm", thousandth),
        (CSV, "x_mm, y_mm, z_mm", "metres", "1000"),
    ),
    Case(
        "micrometres",
        column("[xyz]_mm", lambda v: str(1000 * float(v))),
        (CSV, "points that move", "convert"),
        "external-point",
    ),
    Case(
        "two balls swapped",
        cell(5, "ball", "3"),
        (CSV, "row 5", "ball", "balls 1 and 2", "swapped"),
    ),
    Case(
        "ball moved between",
        cell(5, "x_mm", "7"),
        (CSV, "row 5", "ball", "rows 4 and 5", "correct"),
    ),
    # artefact.csv
    Case("no artefact.csv", remove(ART), (ART, "no such file", "put it there")),
    Case("artefact without radius", drop("radius_mm", ART), (ART, "column radius_mm", "add it")),
    Case(
        "ball twice", cell(3, "ball", "1", ART), (ART, "row 3", "ball", "once", "number the balls")
    ),
    Case("radius zero", cell(3, "radius_mm", "0", ART), (ART, "row 3", "radius_mm", "correct it")),
    Case(
        "artefact in metres",
        column("[xyz]_mm|radius_mm", thousandth, file=ART),
        (ART, "row 2", "radius_mm", "metres"),
    ),
    Case("artefact not finite", cell(4, "y_mm", "nan", ART), (ART, "row 4", "y_mm", "correct")),
    # Parquet
    Case(
        "not Parquet",
        both(write("samples.parquet", b"PAR1 no"), sub(TOML, "samples.csv", "samples.parquet")),
        ("samples.parquet", "cannot be read", "write it again"),
    ),
    Case(
        "Parquet list",
        parquet(sample=[1], q1_deg=[[1.0, 2.0]]),
        ("samples.parquet", "column q1_deg", "list", "convert"),
    ),
    Case(
        "Parquet null",
        parquet(sample=[1, 2], q1_deg=[1.0, None]),
        ("samples.parquet", "row 2", "q1_deg", "fill it"),
    ),
    Case(
        "Parquet text",
        parquet(sample=["1"], q1_deg=[1.0]),
        ("samples.parquet", "column sample", "string", "convert"),
    ),
]
