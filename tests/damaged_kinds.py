"""Some two hundred kinds of vehicle that are none: the hopper of its page with one thing wrong, by kind of damage."""

from collections.abc import Iterator
from dataclasses import dataclass

OTHER = "from models.kinds.kind import Invariant, Suspension\nOTHER = dict(KIND.__dict__)\n"  # the kind's parts, to be changed


@dataclass(frozen=True)
class Damage:
    """Something wrong with a kind of vehicle.

    Attributes:
        what: in words, for the test's name.
        suffix: of the file that is damaged: py or xml.
        said: what the message must name.
        old, new: text of the file and what comes in its place; without an old one, `new` is appended.
    """

    what: str
    suffix: str
    said: str
    new: str
    old: str = ""


def damages() -> Iterator[Damage]:
    """All of them."""
    yield from _matrices()
    yield from _names()
    yield from _rests()
    yield from _parts()
    yield from _failures()
    yield from _models()


def _changed(**parts: str) -> str:
    """Python that makes another kind with other parts, each an expression in OTHER."""
    return OTHER + "".join(f"OTHER[{name!r}] = {part}\n" for name, part in parts.items()) + "KIND = VehicleKind(**OTHER)\n"


def _of_linear_model(field: str, value: str) -> str:
    replaced = f"__import__('dataclasses').replace(linear_model(p), {field}=(lambda M: {value})(linear_model(p).{field}))"
    return _changed(linear_model=f"lambda p: {replaced}")


def _matrices() -> Iterator[Damage]:
    values = (
        "M * np.nan", "M + np.inf", "M - np.inf", "M + 1e308", "M[:-1]", "M[None]", "None", "'x'", "{}", "[]", "p",
        "np.where(np.arange(M.size).reshape(M.shape) == M.size - 1, np.nan, M)",
    )  # fmt: skip
    for k, name in enumerate(("A", "B", "Bw", "C", "D", "Br", "Cr")):
        for value in values if k == 0 else values[k % 3 :: 3]:  # one check is for them all
            yield Damage(f"{name} = {value}", "py", "linear_model", _of_linear_model(name, value))
        yield Damage(f"{name} is complex", "py", f"{name} has complex entries", _of_linear_model(name, "M + 0j"))
    for value in ("0.0", "-1.0", "np.nan", "np.inf", "'x'", "None", "M * 1j"):
        yield Damage(f"twist_rate = {value}", "py", r"linear_model fails \(twist_rate", _of_linear_model("twist_rate", value))


def _names() -> Iterator[Damage]:
    for name in ("states", "inputs", "disturbances", "outputs"):
        for value in ("()", "M[0]", "(*M[1:], M[0][:-1])", "(*M, M[0])", "(1,) * len(M)", "None"):
            yield Damage(f"{name} = {value}", "py", "linear_model", _of_linear_model(name, value))
    for name, row in (("D", 0), ("Cr", 1), ("C", 3)):  # a state that is more than itself, a force that is
        value = f"np.where(np.arange(4)[:, None] == {row}, 1.0, M)"
        yield Damage(f"{name}[{row}] = 1", "py", "linear_model gives an output", _of_linear_model(name, value))
    yield Damage("outputs in another order", "py", "linear_model gives an output", _of_linear_model("outputs", "M[::-1]"))
    yield Damage("states in another order", "py", "linear_model gives an output", _of_linear_model("states", "M[::-1]"))

    for row, name in ((1, "state"), (3, "input")):  # which only some vehicles would have
        less = f"(*OTHER['signals'][:{row + 2}], *OTHER['signals'][{row + 3}:])"
        yield Damage(
            f"{name} on demand",
            "py",
            "a signal on demand; every vehicle has its states and inputs",
            _changed(on_demand=f"OTHER['signals'][{row + 2}:{row + 3}]", signals=less),
        )


def _rests() -> Iterator[Damage]:
    values = (
        "0", "-0.1", "np.nan", "np.inf", "'x'", "None", "True", "[0.1]", "1j", "np.zeros(1)", "np.float64(0)", "10**400", "-0.0"
    )  # fmt: skip
    for value in values:
        code = _changed(static_tyre_deflection=f"lambda p: {{'tyre_deflection': {value}}}")
        yield Damage(f"rest = {value}", "py", "static_tyre_deflection", code)
    for value in ("{}", "None", "0.01", "{'tyre': 0.01}", "{'tyre_deflection': 0.01, 1: 0.01}", "[('tyre_deflection', 0.01)]"):
        yield Damage(f"rests = {value}", "py", "static_tyre_deflection", _changed(static_tyre_deflection=f"lambda p: {value}"))


def _parts() -> Iterator[Damage]:
    wheel, load = "OTHER['wheels'][0].__dict__", "__import__('models.kinds.kind').kinds.kind.BodyLoad"
    parts = {
        "parameters": ("None", "3", "('mass', 'stiffness')", "OTHER['parameters'] * 2", "(Parameter(3, 'kg', 'x'),)",
                       "(Parameter('a mass', 'kg', 'x'),)", "(Parameter('', 'kg', 'x'),)", "(Parameter('mass', 1, 'x'),)",
                       "(Parameter('mass', 'kg', None),)", "(Parameter('mass', 'kg', 'x', varied=2),)",
                       "(Parameter('mass', 'kg', 'x', usual='1'),)"),
        "loads": ("None", "3", "('heave_load',)", f"({load}('push', 'mass'),)", f"({load}('heave_load', 3),)",
                  f"({load}('heave_load', 'mass'),) * 2", f"({load}('heave_load', 'mass'),)"),
        "angles": ("None", "3"),
        "lacking": ("None", "('bar',)", "{'bar': 1}", "{1: 'no bar'}"),
        "signals": ("None", "()", "OTHER['signals'] * 2", "OTHER['signals'][1:]", "OTHER['signals'][:-1]",
                    "tuple(one.name for one in OTHER['signals'])", "(*OTHER['signals'], signals.PITCH_RATE)",
                    "(*OTHER['signals'], signals.Signal('x', None, 'm', 'x'))",
                    "(*OTHER['signals'], signals.Signal('a\\nb', 'x', 'm', 'x'))",
                    "(*OTHER['signals'], signals.Signal('controller_1', 'x', 'm', 'x'))"),
        "on_demand": ("None", "3", "signals.PITCH_RATE", "('pitch_rate',)", "(signals.PITCH_RATE,)",
                      "(OTHER['signals'][-1],)", "(signals.ROLL_RATE,) * 2",
                      "(signals.Signal('tyre_deflection', 'x', 'm', 'x'),)", "(signals.Signal('x', None, 'm', 'x'),)"),
        "wheels": ("None", "()", "OTHER['wheels'] * 2", "('road',)", "OTHER['wheels'][0]",
                   f"(Wheel(**{wheel} | {{'road_body': None}}),)", f"(Wheel(**{wheel} | {{'road_velocity': 'x'}}),)",
                   f"(Wheel(**{wheel} | {{'road_displacement': 'road_velocity'}}),)",
                   f"(Wheel(**{wheel} | {{'tyre_deflection': 'road_displacement'}}),)",
                   f"(Wheel(**{wheel} | {{'side': 'middle'}}),)", f"(Wheel(**{wheel} | {{'behind': 2.0}}),)",
                   f"(Wheel(**{wheel} | {{'behind': lambda p: np.nan}}),)", f"(Wheel(**{wheel} | {{'behind': lambda p: -1}}),)",
                   f"(Wheel(**{wheel} | {{'behind': lambda p: p['length']}}),)",
                   f"(Wheel(**{wheel} | {{'lateral': None}}),)"),
        "combined": ("None", "[]", "{'x': {}}", "{'tyre_deflection': {}}", "{'tyre_deflection': {'tyre_deflection': np.nan}}",
                     "{'tyre_deflection': {'tyre_deflection': 0}}", "{'tyre_deflection': {1: 1.0}}", "{1: {'x': 1}}"),
        "suspended": ("3", "'suspension'", "('tyre_deflection',)", "(Suspension(3, 'tyre'),)", "(Suspension('x', 'tyre'),)",
                      "(Suspension('tyre_deflection', ''),)", "(Suspension('tyre_deflection', 'tyre', 'x'),)",
                      "(Suspension('tyre_deflection', 'tyre'),) * 2", "(Suspension('tyre_deflection', 'tyre', None),)",
                      "(Suspension('tyre_deflection', 'tyre', stiffness='x'),)",
                      "(Suspension('tyre_deflection', 'tyre', damping=[]),)"),
        "invariants": ("None", "3", "(1,)", "(Invariant(1, ('tyre_deflection',), len, len),)", "(Invariant('x', (), len, len),)",
                       "(Invariant('x', ('x',), len, len),)", "(Invariant('x', ([],), len, len),)",
                       "(Invariant('x', ('tyre_deflection',), 1.0, len),)", "(Invariant('x', ('tyre_deflection',), len, None),)",
                       "(Invariant('a\\nb', ('tyre_deflection',), len, len),)"),
        "linear_model": ("None", "lambda: None", "lambda p: None", "lambda p: linear_model", "linear_model({})", "dict"),
        "static_tyre_deflection": ("None", "lambda p: p['x']", "7"),
        "write_mjcf": ("None", "write_mjcf({}, {})", "lambda p: None", "lambda spec, p: spec.nothing"),
        "check_together": ("None", "lambda p: p['x']", "0"),
        "name": ("None", "'../hopper'", "'Hopper'", "7"),
    }  # fmt: skip
    for name, values in parts.items():
        for value in values:
            yield Damage(f"{name} = {value}", "py", "hopper.py", _changed(**{name: value}))


def _failures() -> Iterator[Damage]:
    """Python that fails, in every function: the message has its line."""
    raising = {
        "KeyError": "raise KeyError('x')",
        "SystemExit": "raise SystemExit('x')",
        "Mine": "raise type('Mine', (BaseException,), {})('x')",
        "Silent": "raise type('Silent', (Exception,), {'__str__': lambda self: 1 / 0})()",
        "RecursionError": "linear_model.__class__(fail.__code__, globals())(*some) if 0 else fail(*some)",
        "MemoryError": "raise MemoryError",
        "LinAlgError": "np.linalg.inv(np.zeros((2, 2)))",
        "it needs more": "raise __import__('models.common.errors').common.errors.InputError('it needs more')",
    }
    for said, code in raising.items():
        for name in ("linear_model", "static_tyre_deflection", "write_mjcf", "check_together"):
            if not (said == "it needs more" and name == "check_together"):  # that is what it is there for
                new = f"def fail(*some):\n    {code}\n{_changed(**{name: 'fail'})}"
                yield Damage(f"{name} raises {said}", "py", rf"{name} fails \({said}.*line \d+\)", new)
        yield Damage(
            f"the file raises {said}", "py", rf"the file fails \({said}.*line \d+\)", f"def fail(*some):\n    {code}\nfail()"
        )
    for what, new in {"brackets": "(" * 500, "no Python": "def"}.items():
        yield Damage(what, "py", "is not Python", new)
    yield Damage("a NUL", "py", r"not a text file in UTF-8 \(a NUL character", "\x00")
    new = "from models.kinds.kind import Variation\nVariation('mass', 2, 1)"
    yield Damage("no variation", "py", r"the file fails \(mass varies by .*line \d+\)", new)


def _models() -> Iterator[Damage]:
    """Models that are none, as they are drawn or by what is written into them."""
    for value in ("np.nan", "np.inf", "-1.0", "0.0", "'x'", "None", "[1, 2]"):
        written = f"lambda spec, p: setattr(spec.body('sprung'), 'mass', {value})"
        yield Damage(f"mass = {value}", "py", "write_mjcf", _changed(write_mjcf=written))
    for value in ("np.nan", "np.inf"):
        written = f"lambda spec, p: spec.tendon('tyre').stiffness.__setitem__(0, {value})"
        yield Damage(f"stiffness = {value}", "py", "write_mjcf", _changed(write_mjcf=written))
    sensor = '<jointvel name="sprung_velocity" joint="sprung" user="1"/>'
    for what, old, new in (
        ("no user", ' user="1"/>', "/>"),
        ("user is zero", 'joint="sprung" user="1"', 'joint="sprung" user="0"'),
        ("user is NaN", 'user="0 0 1"', 'user="0 0 nan"'),
        ("no sensor", sensor, ""),
        ("twice the sensor", sensor, sensor * 2),
        ("sensor of nothing", 'joint="sprung" user', 'joint="nobody" user'),
        ("a ball", "<joint name=", '<joint name="ball" type="ball"/><joint name='),
        ("free", '<joint name="sprung" type="slide" axis="0 0 1"/>', '<freejoint name="sprung"/>'),
        ("a motor of another name", 'motor name="control_force"', 'motor name="force"'),
        ("two motors", "</actuator>", '<motor name="more" joint="sprung"/></actuator>'),
        ("no road", 'mocap="true"', ""),
        ("no XML", "</mujoco>", ""),
        ("nothing in it", "<mujoco model", "<nothing model"),
        ("unknown element", "<worldbody>", "<worldbody><nothing/>"),
        ("numbers that are none", 'pos="0 0 .3"', 'pos="0 0 x"'),
        ("NaN", 'pos="0 0 .3"', 'pos="0 0 nan"'),
        ("a hub too low", 'pos="0 0 .3"', 'pos="0 0 .25"'),
        ("a tyre read upside down", 'tendon="tyre" user="1"', 'tendon="tyre" user="-1"'),
    ):
        yield Damage(what, "xml", "hopper.xml|hopper.py: write_mjcf", new, old)
