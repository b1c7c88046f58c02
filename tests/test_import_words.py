"""Header words of six more languages, units of covariates, and the encodings of their files."""

import numpy as np
import pytest

from datasets.importers.mapping.columns.headers import read_header
from datasets.importers.mapping.conversion import other_columns
from datasets.importers.mapping.model import Mapping
from datasets.importers.mapping.proposal import propose
from datasets.importers.source import RawTable
from datasets.importers.sources.tables.text_tables import read_text_table
from workbench.core.errors import InputError

WORDS = {
    "joint": [
        *("Articulation 3", "Axe 3", "Giunto 3", "Asse 3", "Articulación 3", "Eje 3 [°]"),
        *("Junta 3", "Eixo3", "关节3", "轴3 (度)", "關節3", "関節3[deg]", "軸3角度", "ジョイント3"),
    ],
    "time": [
        *("Temps", "Heure", "Tempo (s)", "Ora", "Data e ora", "Tiempo", "Hora", "Fecha y hora"),
        *("时间", "時間", "時刻", "日時"),
    ],
    "temperature_c": ["Température", "Temperatura [°C]", "Température °C", "温度(℃)", "溫度"],
    "payload_kg": ["Charge [kg]", "Carico", "Carga (kg)", "Charge utile", "负载", "負荷 [kg]"],
    "xyz": [
        "Posizione X",
        "Posición X (mm)",
        "Posição X",
        "Cible X",
        "位置X",
        "座標 X(毫米)",
        "Ｘ",
    ],
    "word": ["Lacet", "Imbardata", "Guiñada", "偏航", "ヨー"],
    "sample": ["Mesure n°", "Numero", "Número", "编号", "番号"],
}


@pytest.mark.parametrize(
    "kind, header", [(kind, header) for kind, headers in WORDS.items() for header in headers]
)
def test_a_header_word_is_known(kind, header):
    found = read_header(header)
    assert found.kind == kind
    assert kind != "joint" or found.label == "3"
    assert kind != "word" or found.label == "yaw"


@pytest.mark.parametrize(
    "header, unit",
    [
        ("Giunto 1 [gradi]", "deg"),
        ("Articulación 1 (grados)", "deg"),
        ("Axe 1 [degrés]", "deg"),
        ("Axe 1 [grades]", "gon"),
        ("关节1 (弧度)", "rad"),
        ("位置X(毫米)", "mm"),
        ("q[1]", None),
        ("qw [1]", "1"),
    ],
)
def test_a_unit_is_known(header, unit):
    assert read_header(header).unit == unit


def table(**columns) -> RawTable:
    cells = {name: np.array(values, float) for name, values in columns.items()}
    return RawTable("t.csv", cells, np.arange(2))


@pytest.mark.parametrize(
    "header, cells, target, expected",
    [
        ("Carga (g)", [500, 2500], "payload_kg", [0.5, 2.5]),
        ("Load [lb]", [0, 10], "payload_kg", [0, 4.5359237]),
        ("Temperature (F)", [32, 212], "temperature_c", [0, 100]),
        ("Temp [K]", [273.15, 293.15], "temperature_c", [0, 20]),
    ],
)
def test_a_covariate_is_converted(header, cells, target, expected):
    one = table(**{header: cells})
    mapping = propose(one).mapping
    assert mapping.columns == {header: target}
    np.testing.assert_allclose(other_columns(one, mapping)[target], expected, atol=1e-9)


def test_a_column_of_another_quantity_is_no_covariate():
    one = table(**{"Load [mm]": [1, 2]})
    assert propose(one).mapping.columns == {}
    with pytest.raises(InputError, match=r"column Load \[mm\]: expected a unit of payload_kg"):
        other_columns(one, Mapping(columns={"Load [mm]": "payload_kg"}))


@pytest.mark.parametrize(
    "encoding, header",
    [
        ("shift_jis", "時刻,関節1,温度"),
        ("gb18030", "时间,关节1,温度"),
        ("cp1252", "Temps,Réflecteur X,Température"),
    ],
)
def test_the_encoding_is_found_from_known_words(encoding, header, tmp_path):
    path = tmp_path / "t.csv"
    path.write_bytes(f"{header}\n1,2,3\n2,3,4\n".encode(encoding))
    assert list(read_text_table(path).columns) == header.split(",")


def test_quotes_group_thousands(tmp_path):
    path = tmp_path / "t.csv"
    path.write_text("X;Y\n1'234.56;-987.1\n-12'345.5;0.5\n")
    found = read_text_table(path)
    np.testing.assert_array_equal(found.columns["X"], [1234.56, -12345.5])
