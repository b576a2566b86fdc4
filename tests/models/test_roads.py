"""Roads: coherence and repeatability of ISO 8608's, exact derivatives of all, measured profiles, logs, and bad input."""

import io
import itertools
import json
import re
import zipfile

import numpy as np
import pytest
from scipy import signal, special
from scipy.io import savemat

from models.common.errors import InputError
from models.roads import opencrg, profile_file
from models.roads.choice import choose_road
from models.roads.description import described_road
from models.roads.iso8608 import Iso8608, long_enough
from models.roads.obstacles import OBSTACLES, Flat, Pothole, Step, WattsHump
from models.roads.profile import Profile
from models.roads.profile_file import read_profile
from models.roads.road import Bump, ScaledRoad
from models.roads.sinusoids import random_road, sinusoid
from models.roads.spectrum import coherency
from models.vehicle.vehicle import read_vehicle
from tests.support.commands import refused

STEP = 0.04  # m between samples

X = np.linspace(0, 30, 301)
ROADS = [
    Iso8608("C", 3, 20.0, 1.5),
    *(obstacle() for name, obstacle in OBSTACLES.items() if name != "flat"),
    Profile(X, 0.01 * np.stack([np.sin(X), np.cos(2 * X)], axis=-1), 10.0),
    Iso8608("A", 1, 15.0).scaled(0.3),
    Iso8608("", 2, 20.0, 1.5, gd=32e-6, waviness=2.6, lowest=0.011, highest=2.83),
    WattsHump().scaled(0.01),
]


def repetition(road, distance):
    """Largest autocorrelation of a road's velocity at lags beyond 5 m."""
    w = road.velocity(np.arange(round(distance / STEP)) * STEP / road.speed + 0.1)
    w = w - w.mean()
    full = signal.correlate(w, w, method="fft")[len(w) - 1 :]
    overlap = np.arange(len(w), 0, -1)
    lags = slice(round(5 / STEP), round(0.9 * len(w)))
    return np.abs(full / overlap)[lags].max() / np.mean(w**2)


def test_nothing_repeats():
    """Within a run no stretch of road looks like another; a generator that does repeat is caught by the same measure."""
    assert (
        max(repetition(Iso8608("C", seed), 400) for seed in range(5)) < 0.4
    )  # the last lags have 40 m, 200 waves: 5 / sqrt(200)
    assert repetition(Iso8608("C", 0, length=100.0), 400) > 0.99
    assert long_enough(200) == 1024
    assert long_enough(1025) == 2048


def test_same_seed_same_road():
    """A seed is the same road everywhere, these heights; another is another one, and neither thread nor order matters."""
    t = np.array([0.1, 1.0, 9.5])
    pinned = [0.01486317156454372, -0.01737598514806169, 0.002038889551100681]
    assert np.allclose(Iso8608("C", 7, 20.0).displacement(t), pinned, rtol=1e-9, atol=0)  # rounding of 10 230 sines
    assert not np.allclose(Iso8608("C", 8, 20.0).displacement(t), pinned, rtol=0.1)
    assert np.array_equal(np.random.Philox(7).random_raw(2), [8648156199155761070, 7861003179181181637])


def test_even_times_are_no_other_road():
    """Heights and velocities at evenly spaced times, by chirp z-transform, are those of the plain sum, under every wheel."""
    road, t = Iso8608("D", 2, 17.3, 1.51), np.arange(5000) * 1e-3 - 0.16
    some = np.arange(0, 5000, 97)
    for function in (road.displacement, road.velocity):
        for side in ("left", "right"):
            even, plain = function(t, side)[some], function(np.append(t[some], 9.0), side)[:-1]
            assert np.abs(even - plain).max() < 1e-11 * np.abs(plain).max()  # rounding of the phases of 10 230 lines


def test_a_vertical_step():
    """A step of no edge jumps at its start, is 0 there and left of it, and is said in logs; a step of old logs begins at once."""
    road = choose_road("step:height=0.02:edge=0:start=0.3").build(read_vehicle("quarter_car"), 10.0, 0, 1.0)
    assert isinstance(road, Step)
    assert road.displacement(np.array([0.0, 0.3, 0.3 + 1e-6, 9.0])).tolist() == [0.0, 0.0, 0.02, 0.02]
    assert road.jumps == ((0.3, 0.02),)
    assert road.scaled(2.0).jumps == ScaledRoad(road, 2.0).jumps == ((0.3, 0.04),)
    assert described_road(json.loads(json.dumps(road.describe()))) == road
    assert described_road({"type": "step", "height": 0.02, "edge": 0.1, "speed": 5.0}) == Step(0.02, 0.1, 5.0)
    with pytest.raises(InputError, match="step edge = 1e-05 is not allowed"):
        Step(edge=1e-5)


@pytest.mark.parametrize("road", ROADS, ids=lambda road: road.describe()["type"])
def test_velocity_is_the_derivative(road):
    """The integral of the velocity between any two times, with no kink between, is the difference of the heights, to rounding."""
    side, (nodes, weights) = "right", np.polynomial.legendre.leggauss(60)
    edges = np.unique([-0.5, *road.kinks, *(0.37 * np.arange(1, 8))])
    tested, size = 0, np.abs(road.displacement(np.linspace(0, 3, 300), side)).max()
    for a, b in itertools.pairwise(edges):
        # Narrow enough for the quadrature: 10 ms are two waves of the shortest, and less than a piece of the spline.
        for start in np.linspace(a, max(a, b - 0.01), 3):
            end = min(start + 0.01, b)
            half = (end - start) / 2
            inside = np.array([start, end])
            inside[0], inside[1] = start + 1e-15, end - 1e-15
            change = np.diff(road.displacement(inside, side))[0]
            integral = half * weights @ road.velocity(start + half * (nodes + 1), side)
            assert abs(change - integral) < 1e-12 * size
            tested += change != 0
    assert tested > 2


def test_coherency_is_the_surfaces():
    """It is the integral over all transverse waves of the surface spectrum (n^2 + m^2)^(-(w + 1)/2): by plain quadrature."""
    m = np.linspace(-400, 400, 800_001)
    for n, width, waviness in ((0.1, 1.5, 2.0), (0.5, 1.0, 2.0), (1.0, 0.3, 2.0), (0.3, 1.5, 2.6), (0.3, 1.5, 1.5)):
        surface = (n**2 + m**2) ** (-(waviness + 1) / 2)
        ratio = np.sum(surface * np.cos(2 * np.pi * m * width)) / np.sum(surface)
        assert coherency(np.array([n]), width, waviness)[0] == pytest.approx(ratio, abs=1e-4)  # the ends of the quadrature
    assert special.k1(1.0) == pytest.approx(coherency(np.array([1.0]), 1 / (2 * np.pi))[0])
    assert coherency(np.array([1.0]), 0.0)[0] == 1.0


def test_roughness_as_the_literature_has_it():
    """A class and its G_d(n0) give the same road to the last bit, a limit that of twice the lower class; spectra are as given."""
    vehicle, t = read_vehicle("full_car"), np.linspace(0, 5, 5001)

    def heights(text, side="right"):
        return choose_road(text).build(vehicle, 20.0, 3, 100.0).displacement(t, side)

    assert np.array_equal(heights("iso8608:class=D"), heights("iso8608:gd=1024e-6"))
    assert np.array_equal(heights("iso8608:class=A/B"), heights("iso8608:gd=32e-6"))
    road = choose_road("iso8608:gd=64e-6:waviness=2.6:band=0.02..3").build(vehicle, 20.0, 1, 1e4)
    assert isinstance(road, Iso8608)
    x = np.arange(0, road.length, 0.05)
    n = np.fft.rfftfreq(len(x), 0.05)
    for side in ("left", "right"):
        density = 2 * np.abs(np.fft.rfft(road.displacement(x / 20.0, side)) / len(x)) ** 2 * road.length
        for low, high in ((0.03, 0.05), (0.1, 0.2), (1.0, 1.5)):
            part = (n > low) & (n < high)
            # The left track has these amplitudes; the right one's are random where it is neither alike nor independent
            allowed = 1e-9 if side == "left" else 0.05
            assert np.mean(density[part] / (64e-6 * (n[part] / 0.1) ** -2.6)) == pytest.approx(1, abs=allowed)
        assert density[(n > 3.1) | ((n < 0.0199) & (n > 0))].max() < 1e-12 * density.max()


def test_profile_from_a_file(tmp_path):
    """A file's heights are met at its distances, left and right, with or without headings, from the first heights' mean on."""
    path = tmp_path / "road.csv"
    path.write_text("distance,left,right\n5,0.10,0.20\n5.5,0.12,0.2\n6,0.11,0.25\n6.4,0.1,0.2\n")
    road = read_profile(path, 2.0)
    t = np.array([0.0, 0.25, 0.5, 0.7, 9.0])
    assert road.displacement(t, "left") == pytest.approx([-0.05, -0.03, -0.04, -0.05, -0.05], abs=1e-15)
    assert road.displacement(t, "right") == pytest.approx([0.05, 0.05, 0.1, 0.05, 0.05], abs=1e-15)
    path.write_text("0,0\n1,.1\n2,.2\n3,.1\n")
    assert read_profile(path, 1.0).displacement(np.array([2.0]), "right") == pytest.approx([0.2])


@pytest.mark.extra
def test_opencrg(tmp_path):
    """An OpenCRG surface is met where the wheels run, left and right; one that is too narrow, or none, is refused."""
    pyopencrg = pytest.importorskip("pyopencrg")
    u, v = np.arange(0, 5, 0.1), np.arange(-1, 1.01, 0.25)
    heights = 0.02 * np.sin(u)[:, None] + 0.01 * v * np.cos(u)[:, None]
    pyopencrg.CrgRoad(heights, u_inc=0.1, v=v).save(tmp_path / "road.crg", fmt="KDBI")
    choice = choose_road("road.crg", tmp_path)
    car, quarter = read_vehicle("full_car"), read_vehicle("quarter_car")
    t = np.array([0.5, 1.7])
    for side, v0 in (("left", 1.51 / 2), ("right", -1.51 / 2)):
        expected = 0.02 * np.sin(t * 2) + 0.01 * v0 * np.cos(t * 2)
        assert choice.build(car, 2.0, 0, 9.0).displacement(t, side) == pytest.approx(expected, abs=1e-9)
    assert choice.build(quarter, 2.0, 0, 9.0).displacement(t) == pytest.approx(0.02 * np.sin(t * 2), abs=1e-9)
    pyopencrg.CrgRoad(heights[:, 3:6], u_inc=0.1, v=v[3:6]).save(tmp_path / "narrow.crg", fmt="KDBI")
    with pytest.raises(InputError, match="is less than the vehicle's track"):
        choose_road("narrow.crg", tmp_path).build(car, 2.0, 0, 9.0)
    (tmp_path / "none.crg").write_text("distance,height")
    with pytest.raises(InputError, match="not an OpenCRG file"):
        choose_road("none.crg", tmp_path)


BAD_SURFACES = [  # (pattern in the file, its replacement, part of the message)
    ("reference_line_increment .*", "reference_line_increment = 1e400", "(cannot convert float infinity"),
    ("D:long section 3,m", "D:long section x,m", "(could not convert string to float: 'x'); give"),
    (r" \.010000000000000000", " hello world 1234567", "(1 unreadable value(s) in the data (read as NaN)); give"),
    (r"\$KD_DEF", "$ROAD_CRG_FILE\nnone.crg\n$\n$KD_DEF", "(the data file referenced in the $ROAD_CRG_FILE block"),
]


@pytest.mark.extra
@pytest.mark.parametrize("form", ["LDFI", "KRBI"])
def test_cut_opencrg(tmp_path, form):
    """A surface that was cut between two cross-sections, where the reader warns only, or anywhere else is refused."""
    pyopencrg = pytest.importorskip("pyopencrg")
    path, heights = tmp_path / "road.crg", np.random.default_rng(1).normal(0, 0.01, (50, 5))
    pyopencrg.CrgRoad(heights, u_inc=0.1, v=np.linspace(-1, 1, 5)).save(path, fmt=form)
    content = path.read_bytes()
    data = content.index(b"\n", content.index(b"$$$$$$$$$$")) + 1
    for cut in (data, data + 80, data + 160, (data + len(content)) // 2, len(content) - 7):
        path.write_bytes(content[:cut])
        with refused(f"road file {path}: "):
            choose_road("road.crg", tmp_path)


@pytest.mark.extra
@pytest.mark.parametrize(("old", "new", "said"), BAD_SURFACES, ids=[row[2][:40] for row in BAD_SURFACES])
def test_bad_opencrg(tmp_path, old, new, said):
    """A damaged OpenCRG file is refused in one line with the words of PyOpenCRG."""
    pyopencrg = pytest.importorskip("pyopencrg")
    heights = 0.01 * np.arange(-1, 1.01, 0.25) + np.sin(np.arange(50))[:, None] / 50
    path = tmp_path / "road.crg"
    pyopencrg.CrgRoad(heights, u_inc=0.1, v=np.arange(-1, 1.01, 0.25)).save(path, fmt="LDFI")
    content = path.read_text()
    changed = re.sub(old, new.replace("\\", r"\\"), content, count=1)
    assert changed != content, "the test changes what is there"
    choose_road("road.crg", tmp_path)
    path.write_text(changed)
    with refused(f"road file {path}: this is not an OpenCRG file {said}"):
        choose_road("road.crg", tmp_path)


@pytest.mark.extra
def test_opencrg_in_two_files(tmp_path):
    """An OpenCRG file may name the file with its data."""
    pyopencrg = pytest.importorskip("pyopencrg")
    road = pyopencrg.CrgRoad(np.random.default_rng(0).normal(0, 0.01, (57, 5)), u_inc=0.1, v=np.linspace(-1, 1, 5))
    road.save(tmp_path / "data.crg", fmt="KDBI")
    (tmp_path / "road.crg").write_text("$CT\n$ROAD_CRG_FILE\ndata.crg\n$\n")
    whole, named = (opencrg.read_surface(tmp_path / name) for name in ("data.crg", "road.crg"))
    np.testing.assert_array_equal(named.z, whole.z)


@pytest.mark.extra
def test_opencrg_in_parts(tmp_path, monkeypatch):
    """Worked out in parts, to bound the memory, a surface is the same."""
    pyopencrg = pytest.importorskip("pyopencrg")
    heights = np.random.default_rng(0).normal(0, 0.01, (57, 5))
    pyopencrg.CrgRoad(heights, u_inc=0.1, v=np.linspace(-1, 1, 5)).save(tmp_path / "road.crg", fmt="KDBI")
    whole = opencrg.read_surface(tmp_path / "road.crg")
    for at_once in (1, 50, 284):
        monkeypatch.setattr(opencrg, "AT_ONCE", at_once)
        # where along u a height lies may differ by the last bit of 5.6 m, 9e-16 m, times a slope of about 0.5
        assert opencrg.read_surface(tmp_path / "road.crg").z == pytest.approx(whole.z, rel=0, abs=1e-15)


@pytest.mark.parametrize(
    ("content", "settings"),
    [
        ("0\t0\n0,5\t0,02\n1\t-0,01\n1,5\t0\n", ":separator=tab"),
        ("  0 0\n  0.5   0.02\n1 -0.01\n1.5 0\n", ""),
        ("surveyed by hand\nA 8\ndistance, height\n# in metres\n0,0\n0.5,0.02\n\n1,-0.01\n1.5,0\n", ""),
        ("0,0\n0.5,20\n1,-10\n1.5,0\n", ":height_unit=mm"),
        ("0;0\n0.0005;2\n0.001;-1\n0.0015;0\n", ":distance_unit=km:height_unit=cm"),
        ("0,431\n0.5,431.02\n1,430.99\n1.5,431\n", ""),
        ("7,0,9,0\n7,.5,9,.02\n7,1,9,-.01\n7,1.5,9,0\n", ":columns=2,4"),
        ("0,0,9,0,\n.5,.02,9,.02,\n1,-.01,9,-.01,\n1.5,0,9,0,\n", ":columns=1,2,4"),
        ("0\n20\n-10\n0\n", ":step=0.5:unit=mm"),
        ("left [mm], right [cm]\n0,0\n20,2\n-10,-1\n0,0\n", ":step=500 mm"),
        ("n, height\n1,0\n2,0.02\n3,-0.01\n4,0\n", ":step=0.5"),
    ],
)
def test_a_file_as_people_have_them(tmp_path, content, settings):
    """Separators, decimal commas, headings, units, columns and heights above the sea: all the same road."""
    (tmp_path / "road.csv").write_bytes(content.encode())
    plain = Profile(np.array([0, 0.5, 1, 1.5]), np.array([0, 0.02, -0.01, 0])[:, None] * np.ones(2), 20.0)
    found = choose_road(f"road.csv{settings}", tmp_path).profile
    assert found is not None
    t = np.linspace(0, 0.1, 50)
    for side in ("left", "right"):
        assert found.displacement(t, side) == pytest.approx(plain.displacement(t, side), abs=1e-12)


HEADED = [  # (what stands above, how the numbers are read without it: columns and metres of distance, left, right; options)
    ("distance,right,left", (0, 2, 1), (1, 1, 1), ""),
    ("right,left,distance", (2, 1, 0), (1, 1, 1), ""),
    ("Distance [ft],Right wheel path [cm],Left wheel path [in]", (0, 2, 1), (0.3048, 0.0254, 0.01), ""),
    ("station_ft,l_in,r_in", (0, 1, 2), (0.3048, 0.0254, 0.0254), ""),
    ('"chainage / km","left height / mm","right height / mm"', (0, 1, 2), (1e3, 1e-3, 1e-3), ""),
    ("# distance [m], right [mm], left [mm]", (0, 2, 1), (1, 1e-3, 1e-3), ""),
    ("distance [feet],elevation [inches],t", (0, 1, 1), (0.3048, 0.0254, 0.0254), ""),
    ("time,distance,height", (1, 2, 2), (1, 1, 1), ""),
    ("distance [m],left [mm],right [mm]", (0, 2, 2), (1, 1e-3, 1e-3), ":columns=1,3"),
    ("distance,left [mm],right [mm]", (0, 1, 2), (1, 1e-3, 1e-3), ":height_unit=mm"),
    ("distance [furlong],height [yd],t", (0, 1, 1), (0.3048, 0.01, 0.01), ":distance_unit=ft:height_unit=cm"),
    ("a,b,c", (0, 1, 2), (1, 1, 1), ":columns=1,2,3"),
    ("# the left lane, in m, by hand", (0, 1, 2), (1, 1, 1), ""),
    ("# in,cm,mm", (0, 1, 2), (1, 1, 1), ""),
]


ERD = "ERDFILEV2.00\n  {count}, 4, -1, 1, {key}, 0.5, -1,\nTITLE   by hand\nSHORTNAM{names}\nUNITSNAM{units}\nXUNITS  m\nEND\n"


def test_files_of_other_programs(tmp_path):
    """A spreadsheet, a MATLAB file in four forms, and an ERD file of one or two tracks give the road of the same numbers."""
    x, z = np.arange(4) * 0.5, np.array([0, 0.02, -0.01, 0])
    both, said = np.column_stack([z, 2 * z]), choose_road
    for name, content in {
        "a": {"x": x, "z": z},
        "b": {"road": np.column_stack([x, z])},
        "c": {"p": {"distance": x, "height_mm": 1e3 * z}},
        "d": {"z": z},
    }.items():
        savemat(tmp_path / f"{name}.mat", content)
        found = choose_road(f"{name}.mat{':step=0.5' if name == 'd' else ''}", tmp_path).profile
        assert found is not None
        np.testing.assert_allclose(found.heights, z[:, None] * np.ones(2), atol=1e-15)
        np.testing.assert_allclose(found.distance, x)
    for heights, names, units in ((both, "LElev.  RElev.", "mm      mm"), (both[:, :1], "Elev.", "mm")):
        lines = "\n".join(" ".join(f"{1e3 * value:.1f}" for value in row) for row in heights)
        head = ERD.format(count=heights.shape[1], key=5, names=names, units=units)
        (tmp_path / "road.erd").write_text(f"{head}{lines}\n")
        found = said("road.erd", tmp_path).profile
        assert found is not None
        np.testing.assert_allclose(found.heights, heights * np.ones(2), atol=1e-15)
        np.testing.assert_allclose(found.distance, x)
    (tmp_path / "binary.erd").write_text(ERD.format(count=1, key=1, names="Elev.", units="m"))
    savemat(tmp_path / "uneven.mat", {"x": x, "z": z[1:]})
    for file, words in (
        ("binary.erd", "binary numbers (KEYNUM 1); export it with numbers as text"),
        ("uneven.mat", "x 1x4, z 1x3, which do not form one table"),
        ("a.mat:step=0.5", "step is given, but the file has distances"),
        ("d.mat", "or only heights, with a step as in :step=0.25"),
    ):
        with refused(words):
            choose_road(file, tmp_path)


@pytest.mark.extra
def test_a_spreadsheet(tmp_path):
    """The first sheet of an .xlsx file, or the only one with a table, is a table as a text file is one; two are asked about."""
    pytest.importorskip("python_calamine")
    rows = [["surveyed by hand"], ["distance [m]", "height [mm]"], [0, 0], [0.5, 20.0], [1.0, -10.0], [1.5, 0]]
    (tmp_path / "road.xlsx").write_bytes(spreadsheet(rows))
    found = choose_road("road.xlsx", tmp_path).profile
    assert found is not None
    np.testing.assert_allclose(found.heights[:, 0], [0, 0.02, -0.01, 0])
    for others in ([["run", 17]], []):
        (tmp_path / "road.xlsx").write_bytes(spreadsheet(others, rows))
        again = choose_road("road.xlsx", tmp_path).profile
        assert again is not None
        np.testing.assert_array_equal(again.heights, found.heights)
    (tmp_path / "road.xlsx").write_bytes(spreadsheet(rows, rows))
    with refused("has tables in the sheets s1, s2, but only one sheet can be read"):
        choose_road("road.xlsx", tmp_path)


def spreadsheet(*sheets) -> bytes:
    """The least that is an .xlsx file: sheets with texts in place."""
    text, number = '<c t="inlineStr"><is><t>{}</t></is></c>', "<c><v>{}</v></c>"
    of = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    link, names = f'<Relationship Id="s{{}}" Type="{of}/{{}}" Target="{{}}"/>', range(1, len(sheets) + 1)
    links = "".join(link.format(i, "worksheet", f"worksheets/sheet{i}.xml") for i in names)
    entries = "".join(f'<sheet name="s{i}" sheetId="{i}" r:id="s{i}"/>' for i in names)
    parts = {
        "_rels/.rels": f"<Relationships>{link.format(0, 'officeDocument', 'xl/workbook.xml')}</Relationships>",
        "xl/_rels/workbook.xml.rels": f"<Relationships>{links}</Relationships>",
        "xl/workbook.xml": f'<workbook xmlns:r="{of}"><sheets>{entries}</sheets></workbook>',
    }
    for i, rows in zip(names, sheets, strict=True):
        cells = [[(text if isinstance(value, str) else number).format(value) for value in row] for row in rows]
        body = "".join(f"<row>{''.join(row)}</row>" for row in cells)
        parts[f"xl/worksheets/sheet{i}.xml"] = f"<worksheet><sheetData>{body}</sheetData></worksheet>"
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as file:
        for name, text in parts.items():
            file.writestr(name, text)
    return content.getvalue()


@pytest.mark.parametrize(
    ("above", "columns", "metres", "settings", "separator"),
    [(*row, separator) for row, separator in zip(HEADED, itertools.cycle(",;\t"))],
)
def test_headings(tmp_path, monkeypatch, above, columns, metres, settings, separator):
    """Headings say which column is what, in which order, and in which unit, however separated; prose says nothing."""
    monkeypatch.setattr(profile_file, "WIDEST", np.inf)  # the same numbers in every unit and order are no likely road
    numbers = np.array([[0, 0.01, 0.02], [0.51, 0.03, 0.52], [1.02, 0.04, 1.01], [1.53, 0.05, 1.49], [2.04, 0.07, 2.0]])
    rows = [separator.join(map(str, row)) for row in numbers.tolist()]
    (tmp_path / "road.csv").write_text("\n".join(["Survey of the B 27", above.replace(",", separator), *rows]))
    profile = choose_road(f"road.csv{settings}", tmp_path).profile
    assert profile is not None
    expected = numbers[:, columns] * metres
    assert profile.distance == pytest.approx(expected[:, 0], rel=1e-15)
    assert profile.heights == pytest.approx(expected[:, 1:], rel=1e-15)


@pytest.mark.parametrize(
    ("above", "settings", "said"),
    [
        ("distance,left,right", ":columns=1,3,2", "'right', but this column would be read as the height of the left track"),
        ("a,b,c", "", "column 1 is called 'a', but only columns called distance, height, left, right are read; choose columns"),
        ("distance,a,b [mm]", "", "column 2 is called 'a', but only columns called distance"),
        ("distance,height,height [m]", "", "columns 2, 'height' and 3, 'height [m]', both contain height; choose columns"),
        ("x,station,z", "", "columns 1, 'x' and 2, 'station', both contain distance"),
        ("left,right,distance", ":columns=1,2", "column 1 is called 'left', but this column would be read as distance"),
        ("time,height,right", "", "column 1 is called 'time', but this column would be read as distance"),
        ("distance,speed,height", ":columns=1,2", "column 2 is called 'speed', but this column would be read as height"),
        ("distance [cm],left,right", ":distance_unit=m", "column 1, 'distance [cm]', has a heading with the unit cm, but"),
        ("distance,height [in],t", ":height_unit=mm", "column 2, 'height [in]', has a heading with the unit in, but"),
        ("distance [furlong],left,right", "", "(allowed: cm, ft, in, km, m, mm); convert the column to an allowed unit"),
        ("distance [m],left [m],right [m]\nm,mm,mm", "", "'left [m]' and 'mm' of column 2 contradict each other"),
    ],
)  # fmt: skip
def test_headings_that_contradict(tmp_path, above, settings, said):
    """Headings against the options, against what the order would make of them, or in a unit that is none, are refused."""
    (tmp_path / "road.csv").write_text(f"{above}\n0,0,0\n1,.01,.01\n2,.02,.01\n3,0,0\n")
    with refused(said, f"road file {tmp_path / 'road.csv'}: "):
        choose_road(f"road.csv{settings}", tmp_path)


def survey(count: int = 481) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A rough road along a curve that begins at 45 degrees: distance, coordinates to the east and to the north, heights [m]."""
    s = np.linspace(0, 120, count)
    angle, z = np.pi / 4 + s / 200, 1019 + np.cumsum(np.random.default_rng(4).normal(0, 2e-3, count))
    return s, 709655 + 200 * (np.sin(angle) - np.sin(angle[0])), 5648717 - 200 * (np.cos(angle) - np.cos(angle[0])), z


# The columns of a file by letter (x, y: east and north; z: height; n: number; s: distance; lat, lon), their headings, the factor.
PATHS = [
    ("xyz", "X (m),Y (m),Z (m)", "coordinates; the distance is the length of their path, 1"),
    ("zyx", "elevation,northing,easting", "columns 3 ('easting') and 2 ('northing') are coordinates"),
    ("nxyz", "Punkt,Rechtswert,Hochwert,Höhe", "column 1 ('Punkt') is left out"),
    ("txyzt", "gps time,POINT_X,POINT_Y,z,quality", "columns 1 ('gps time') and 5 ('quality') are left out"),
    ("xyzz", "E,N,left,right", ""),
    ("bac", "GPS latitude [deg],GPS longitude [deg],GPS altitude [m]", "columns 2 ('GPS longitude [deg]') and 1"),
    ("abc", "lon,lat,ele", ""),
    ("sxyz", "chainage,x,y,z", "columns 2 ('x') and 3 ('y') are left out"),
    ("mxyz", "chainage [mm],x,y,z", "is 0.12 m long, but the path"),
]


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("columns", "above", "said"), PATHS)
def test_two_coordinates_and_a_height_are_a_path(tmp_path, columns, above, said, turned):
    """A survey on a map or in degrees has the arc length as its distance, whichever way it runs; other columns are named."""
    s, x, y, z = (one[::-1] if turned else one for one in survey())
    s = 120 - s if turned else s
    first, radius = np.deg2rad(48.0), 6378137.0 / np.sqrt(1 - 0.00669438 * np.sin(np.deg2rad(48.0)) ** 2)  # WGS 84
    north = radius * (1 - 0.00669438) / (1 - 0.00669438 * np.sin(first) ** 2)
    a, b = 11 + np.rad2deg((x - x[0]) / radius / np.cos(first)), 48 + np.rad2deg((y - y[0]) / north)
    cells = {"x": x, "y": y, "z": z, "c": z, "s": s, "m": s, "a": a, "b": b, "n": np.arange(len(s)), "t": ["12:03:04.5"] * len(s)}
    rows = zip(*map(cells.__getitem__, columns), strict=True)
    lines = [",".join(f"{one:.9f}" if isinstance(one, float) else str(one) for one in row) for row in rows]
    (tmp_path / "road.csv").write_text("\n".join([above, *lines]))
    if "m" in columns:
        with refused(said):
            choose_road("road.csv", tmp_path)
        return
    profile = choose_road("road.csv", tmp_path).profile
    assert profile is not None
    # The chords of a circle of 200 m are shorter by 7e-8; degrees bend over 120 m.
    assert profile.distance == pytest.approx(s, abs=1e-3 if "a" in columns else 1e-5)
    assert profile.heights[:, 0] == pytest.approx(z, abs=1e-9)
    assert said in profile.remark(1.0)


def test_a_path_that_is_not_sure(tmp_path):
    """Coordinates without headings, noisy positions, two tracks by turns and falling distances are refused with what to do."""
    s, x, y, z = survey()
    noise = np.random.default_rng(1).normal(0, 0.1, (2, len(s)))
    for above, columns, said in (
        ("", (x, y, z), "the last two columns lack headings and differ by up to 5.6"),
        ("", (x - x[0], y - y[0], z - z[0]), "write headings above line 1, such as x [m], y [m], height [m]"),
        ("x,y,z\n", (x + noise[0], y + noise[1], z), "positions are noisy or not in driving order"),
        ("x,y,z\n", (s, 1.5 * (np.arange(len(s)) % 2), z), "positions are noisy or not in driving order"),
        ("lat,lon,z\n", (1e7 * x, y, z), ", beyond the range of degrees; give decimal degrees, up to 360 for longitude and 90"),
        ("station,x,y,z\n", (np.arange(len(s)), x, y, z), "480 m long, but the path through columns 2 ('x') and 3 ('y') is 120"),
        ("x,z\n", (s[::-1], z), ", and also between all other points; reverse the order of the points"),
        ("x,z\n", (np.sin(s), z), "if this column is a map coordinate, give the other coordinate, too"),
    ):
        (tmp_path / "road.csv").write_text(
            above + "\n".join(",".join(f"{one:.6f}" for one in row) for row in zip(*columns, strict=True))
        )
        with refused(said):
            choose_road("road.csv", tmp_path)
    (tmp_path / "road.csv").write_text("x,y,z\n0,0,1\n3,4,2\n3,4,2\n3,5,3\n")
    profile = choose_road("road.csv", tmp_path).profile
    assert profile is not None
    assert profile.distance == pytest.approx([0, 5, 6])
    assert "1 points have the same position as the previous point" in profile.note


DECIMALS = "0,0,00\n1,0,01\n2,0,02\n3,0,00\n"


@pytest.mark.parametrize(
    ("text", "settings", "tracks"),
    [
        (DECIMALS, "", None),
        ("0,0,0\n1,12,-3\n2,10,0\n3,0,0\n", ":height_unit=mm:separator=comma", 2),
        ("0,0,0.01\n1,0,0\n2,0,0\n3,0,0\n", "", 2),
        ("distance,left,right\n" + DECIMALS.replace("02", "0"), "", 2),
        (DECIMALS.replace("02", "0"), ":separator=comma", 2),
        (DECIMALS.replace("02", "0"), ":columns=1,2,3", 2),
        (DECIMALS.replace(",0,", ";0,"), "", 1),
    ],
)
def test_decimal_commas_between_commas(tmp_path, text, settings, tracks):
    """0,0,01 is two tracks only where that is said, or where a decimal point shows that commas separate; else it is refused."""
    (tmp_path / "road.csv").write_text(text)
    if tracks is None:
        with pytest.raises(InputError, match="one height with a decimal comma; give :separator=comma for two heights"):
            choose_road(f"road.csv{settings}", tmp_path)
        return
    profile = choose_road(f"road.csv{settings}", tmp_path).profile
    assert profile is not None
    assert np.array_equal(*profile.heights.T) == (tracks == 1)


def test_what_is_written_is_read(tmp_path):
    """A profile's own file, with its headings, is the same profile to the last bit."""
    rng = np.random.default_rng(5)
    road = Profile(np.cumsum(rng.uniform(0.1, 0.2, 50)), rng.normal(0, 0.01, (50, 2)), 20.0)
    (tmp_path / "road.csv").write_bytes(road.points)
    again = choose_road("road.csv", tmp_path).profile
    assert again is not None
    assert np.array_equal(again.distance, road.distance)
    assert np.array_equal(again.heights, road.heights)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0,0\n1,0\n2,0\n1.5,0\n3,0\n", "distance falls from 2 m to 1.5 m (line 3 and line 4); sort the points by distance"),
        ("0,0\n1,0\n1,0\n3,0\n", "distance 1 m is repeated (line 2 and line 3); keep only one of the two points"),
        ("0,0\n1,nan\n2,0\n3,0\n", "line 2, column 2: 'nan' is not a finite number; give columns"),
        ("0,0\n1,\n2,0\n3,0\n", "line 2 has 1 column(s), but line 1 has 2"),
        ("0\n1\n2\n3\n", "1 column(s)"),
        ("0,0\n", "a profile needs at least 2 points, but this one has 1"),
        ("", "the file is empty; give columns"),
        ("0,0\n100,20\n200,-10\n300,0\n", "the points are 100 m apart, which is not plausible"),
        ("0,5,1,2\n", "line 1 has 4 column(s)"),
    ],
)
def test_bad_profiles(tmp_path, text, said):
    """A file that is no profile is refused in one line that names it, the place and what is allowed."""
    path = tmp_path / "road.csv"
    path.write_text(text)
    with refused(said, str(path)):
        choose_road(str(path))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("iso8608:class=I", "unknown road class 'I'; give A, B"),
        ("iso8608:rough=C", "the name 'rough' in 'rough=C' is unknown"),
        ("bump:height", "'height' does not have the form NAME=VALUE; NAME must be one of height"),
        ("bump:height=0.05,length=2", "the values in 'height=0.05,length=2' are separated by commas; separate them by colons"),
        ("gravel", "unknown road 'gravel'; give one of iso8608, bump"),
        ("", "unknown road ''; give one of iso8608, bump"),
        (
            "pothole:length=0.3",
            "length = 0.3 m is less than its two edges of 0.2 m; give a length of at least 0.4 m, or set edge to at most 0.15 m",
        ),
        (
            "watts_hump:length=0.1",
            "watts_hump length = 0.1 m is less than twice its height of 0.1 m; give a length of at least 0.2 m",
        ),
        ("sweep:highest=0.1", "sweep highest = 0.1 is not allowed; give a number from 0.5005 to 100 Hz"),
        ("nowhere.csv", "there is no such file"),
        ("road.csv:columns=1", "as in columns=1,3"),
        ("road.csv:offset=3", "the name 'offset' in 'offset=3' is unknown; give one of columns, distance_unit"),
        ("road.crg:height_unit=mm", "contains its own units"),
        ("iso8608:iri=2:class=C", "more than once, by class = C and iri = 2; give only one"),
        ("iso8608:gd=32e-6:iri=2", "more than once, by iri = 2 and gd = 3.2e-05; give only one"),
        ("iso8608:gd=32 mm", "unit of m3 is expected"),
        ("iso8608:class=A/C", "unknown road class 'A/C'; give A, B"),
        ("iso8608:band=3", "give the lower and the upper end in cycle/m, as in band=0.011..2.83"),
        ("iso8608:band=2..0.1", "band = 2..0.1 is not allowed; give both ends, the lower one first, from 0.001 to 100 cycle/m"),
    ],
)
def test_bad_roads(text, said):
    """A road that is none is refused in one line."""
    with refused(said):
        choose_road(text)


EVERY = [
    *ROADS,
    Bump(0.03, 2.0, 7.0, "left"),
    Pothole(track="right"),
    random_road(np.array([1.0, 2.5]), 3, 9.0).scaled(0.1),
    sinusoid(63.6, 8.0),
]


@pytest.mark.parametrize("road", EVERY, ids=lambda road: road.describe()["type"])
def test_a_road_is_level_after_its_duration(road):
    """Nothing moves behind a road's own end, or with the plane of the last 11 m of a measured one, and something does before;
    scaled, it ends then, too, under the same wheels.
    """
    sides = [side for side in ("left", "right") if road.track in ("both", side)]
    if np.isfinite(road.duration):
        assert road.duration == max(road.kinks)
        late, before = road.duration + np.linspace(1e-9, 3.0, 1000), road.duration * np.linspace(0.9, 1 - 1e-6, 1000)
        for side in sides:
            moving, after = np.abs(road.velocity(before, side)).max(), 0.0
            if isinstance(road, Profile):
                ends = np.array(
                    [np.interp(road.distance[-1] - back, road.distance, z) for z in road.heights.T for back in (0, 11)]
                )
                after = road.speed * np.mean(ends[::2] - ends[1::2]) / 11
            assert np.abs(road.velocity(late, side) - after).max() < 1e-12 * moving  # the sine of pi
            further = road.displacement(late, side) - road.displacement(late[:1], side)
            assert further == pytest.approx(after * (late - late[0]), rel=1e-9, abs=1e-12)
    else:
        late = 1e3 + np.linspace(0.0, 3.0, 1000)
        assert all(np.any(road.velocity(late, side) != 0) for side in sides)
    other = road.scaled(0.5)
    assert (other.duration, other.track) == (road.duration, road.track)


def test_roads_that_cannot_be_driven():
    """A road that is over within two timesteps, beside a vehicle's only track, or lost in rounding is refused; a flat road is
    not."""
    quarter, full, time = read_vehicle("quarter_car"), read_vehicle("full_car"), np.arange(1000) * 1e-3
    for vehicle, road, words in (
        (quarter, Bump(length=0.0249), "each wheel is on the road for only 0.00199 s, less than two timesteps of 0.001 s"),
        (
            quarter,
            ScaledRoad(Pothole(track="left"), 2.0),
            "left needs a vehicle with a left and a right track, but a quarter_car has only one track",
        ),
        (full, Bump(height=0.9e-5), "height is at most 9e-06 m during the 0.999 s of the run, but heights below 1e-05 m"),
    ):
        with pytest.raises(InputError, match=words):
            road.check(vehicle, time)
    for vehicle, road in ((quarter, Bump(length=0.0251)), (full, Pothole(track="left")), (full, Bump(height=1.1e-5))):
        road.check(vehicle, time)
        ScaledRoad(road, 0.0).check(vehicle, time)


@pytest.mark.parametrize("road", [*EVERY, Flat()], ids=lambda road: road.describe()["type"])
def test_description_is_enough(road):
    """A road comes back from its description as JSON holds it, to the last bit; a profile needs its points as CSV besides."""
    points = road.points
    again = described_road(json.loads(json.dumps(road.describe())), points)
    t = np.linspace(-0.1, 3.0, 1234)
    for side in ("", "left", "right"):
        assert np.array_equal(again.displacement(t, side), road.displacement(t, side))
        assert np.array_equal(again.velocity(t, side), road.velocity(t, side))
    assert again.speed == road.speed
    assert again.kinks == road.kinks


@pytest.mark.parametrize(
    ("description", "message"),
    [
        ({}, "has no type; give one of bump, chirp"),
        ({"type": "bump", "height": 0.1}, "road bump: the log contains no value of length"),
        ({**Bump().describe(), "factor": "a"}, "road bump: factor = 'a' is not allowed; give a number"),
        ({**Iso8608().describe(), "roughness": "1"}, "roughness = '1' is not allowed; give a number"),
        ({**Iso8608().describe(), "roughness": 1e-3}, "roughness was logged as 0.001, but is now computed as 0.000256"),
        ({**sinusoid(1.0, 1.0).describe(), "omega": [1.0, 2.0]}, "omega, amplitudes and phases have different lengths"),
        ({**sinusoid(1.0, 1.0).describe(), "rms": 1.0}, "rms was logged as 1, but is now computed as 0.707107"),
        ({"type": "profile", "speed": 20.0}, "does not contain the points of the road .profile."),
    ],
)
def test_bad_description(description, message):
    """A description of no road, or of another one than it says, is refused."""
    with pytest.raises(InputError, match=message):
        described_road(description)
