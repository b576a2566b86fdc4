"""Table of the options that can be combined in a controller's section, and of the commands that accept each option.

Two parts of a section, or a part and a command, can be combined unless `REFUSED_PAIRS` contains a reason against the
combination. The messages about refused combinations and the table in the documentation are generated from the table in this
module.
"""

from collections.abc import Collection, Mapping
from itertools import combinations
from typing import Any

from models.common.errors import InputError, short_repr
from models.laws.design_methods import DESIGNS, FULL, GOALS, OF_STATE, PATTERNS, STATIC
from models.laws.design_request import is_order
from models.laws.linear import MATRICES

KINDS = {  # types of controllers; each section has exactly one of them
    "gain": "`gain`",
    "states": "`A`, `B`, `C`, `D`; `pid`",
    "steps": "the two-step design",
    "full": '`order = "full"`',
    "order": "`order = 2`",
    "pid": '`structure = "pid"`',
    **{name: f'`design = "{name}"`' for name in DESIGNS},
    "law": "`law` (Python), `fmu`",
    "semi_active": "`semi_active`",
}
DEMANDS = {  # options that can be added to a type of controller
    "stable": "`stable`",
    "fastest_pole": "`fastest_pole`",
    "anti_windup": "`anti_windup`",
    "noise": "`noise`",
    "lag": "`lag`",
    "sampled": "`sampled`",
    "loads": "`loads`",
    "study": "`study`",
    "goals": "goals",
    "tolerance": "`tolerance`",
    "family": "`family`",
    "force": "`control_force`",
}
# Weights of gain errors in `tolerance`; these errors are not a requirement on a design, so the tables omit them
WEIGHTS = "weights"
COMMANDS = {"refine": "`--refine`", "zero_l": "`--zero-l`", "front": "`--front`", "rates": "`--rates`"}
# Columns of the first table in the documentation
KEYS = ("stable", "fastest_pole", "anti_windup", "noise", "lag", "sampled", "loads", "goals", "force")
FLAGS = ("stable", "noise", "lag", "sampled", "study")

_OF_STATE = "this design uses the full state, not the signals of sensors"
_OTHERS = " ".join(DESIGNS)
_STATES = " ".join(OF_STATE)
_DESIGNED_LAWS = f"full order pid {_OTHERS}"
_GOALS = "goals tolerance family"
_STUDIED_LAWS = f"steps {_DESIGNED_LAWS} semi_active"
_NO_CLAIM = "such a law is used unchanged, and linear analysis does not apply to it"
_REASONS = (  # each entry: a key or command, what it cannot be combined with, and the reason
    (
        "stable",
        f"gain states steps {_OTHERS} {_GOALS}",
        "stable = true is available only for designs with an order",
    ),
    ("stable", "pid", "the integral part has a pole at 0, so the law alone is not stable"),
    (
        "fastest_pole",
        f"gain states steps order pid {_OTHERS} {_GOALS}",
        f'fastest_pole is available only for order = "{FULL}"',
    ),
    ("fastest_pole", "sampled", "in a design for the sampled loop, the sample period already limits the speed"),
    ("anti_windup", f"gain steps {_STATES} {_GOALS}", "a static gain has no states that can wind up"),
    ("noise", _STATES, _OF_STATE),
    ("noise", "lqg", "this design always uses the noise of its sensors"),
    ("lag", _STATES, _OF_STATE),
    ("sampled", "gain states", "a given law is not designed"),
    ("sampled", _OTHERS, "a design for the sampled loop minimises the norm"),
    ("sampled", f"loads {_GOALS}", "a design for the sampled loop minimises the norm from road and noise alone"),
    (
        "study",
        f"{_STUDIED_LAWS} {_GOALS} weights refine front",
        "only a given law may measure heights, because no sensor on a car measures them",
    ),
    ("loads", _OTHERS, "this design is for the response to the road alone"),
    ("loads", _GOALS, "goals describe the response to the road alone"),
    *(
        (goals, f"states {_DESIGNED_LAWS}", "goals are available only for static gains in continuous time")
        for goals in _GOALS.split()
    ),
    ("force", "pid", "each force of this law uses one measured signal"),
    ("force", "steps", "a measured force contains no information about the state"),
    ("force", _STATES, _OF_STATE),
    ("force", "semi_active", "a semi-active law selects its own measured signals"),
    ("refine", f"states {_DESIGNED_LAWS} stable anti_windup {_GOALS}", "only static gains of the smallest norm can be refined"),
    (
        "zero_l",
        f"gain states {_DESIGNED_LAWS} stable anti_windup noise sampled {_GOALS}",
        "only the two-step design has a matrix L",
    ),
    ("front", f"states {_DESIGNED_LAWS} stable anti_windup sampled", "a front consists of designed static gains"),
    ("front", "tolerance weights family", "a front describes one vehicle without uncertainties"),
    (
        "rates",
        f"gain states {_DESIGNED_LAWS} stable anti_windup noise",
        "only two-step gains can be designed again for a sample rate",
    ),
    *((one, "law semi_active", _NO_CLAIM) for one in (*DEMANDS, WEIGHTS, *COMMANDS) if one not in ("force", "study")),
)
REFUSED_PAIRS = {frozenset((one, other)): why for one, others, why in _REASONS for other in others.split()}
ONE_KIND = "a controller has either one given law or one design method"


def refusal(one: str, other: str) -> str:
    """Returns the reason why two parts, or a part and a command, cannot be combined; empty if no reason exists."""
    return ONE_KIND if one != other and {one, other} <= KINDS.keys() else REFUSED_PAIRS.get(frozenset((one, other)), "")


def goes(what: str, parts: Collection[str]) -> bool:
    """Returns True if a part or command can be combined with all parts of a controller's section."""
    return not any(refusal(what, part) for part in parts)


def section_parts(section: Mapping[str, Any], inputs: Collection[str]) -> dict[str, str]:
    """Returns the parts of a controller's section, each with its text as written in the section. The values in the section are
    not checked.
    """
    tolerance = section.get("tolerance")
    errors = [isinstance(one, Mapping) for one in tolerance.values()] if isinstance(tolerance, Mapping) else []
    goal_keys = [key for key in GOALS if key in section and not (key == "tolerance" and errors and all(errors))]
    parts: dict[str, str] = {key: key for key in ("gain", "law", "semi_active") if key in section}
    parts |= {"law": "fmu"} if "fmu" in section else {}
    filtered = isinstance(structure := section.get("structure"), str) and structure in PATTERNS
    if matrices := [key for key in (*MATRICES, "sample_period", *["pid"] * (not filtered)) if key in section]:
        parts["states"] = matrices[0]
    for key in ("order", "design"):
        if key in section and isinstance(section[key], str):
            parts["steps" if section[key] == STATIC else section[key]] = f'{key} = "{section[key]}"'
    if is_order(section.get("order")):
        parts["order" if section["order"] else "steps"] = f"order = {section['order']}"
    if filtered:
        parts["pid"] = f'structure = "{structure}"'
    if not parts and not goal_keys and not {"order", "design"} & section.keys():
        parts["steps"] = "the default two-step design"
    parts |= {key: f"{key} = true" for key in FLAGS if section.get(key) is True}
    # `structure` then describes the law in the file; it is not a goal for the design of a static gain
    of_law = filtered or "order" in parts
    if goals := [key for key in goal_keys if not (of_law and key == "structure")]:
        parts["goals"] = goals[0]
    parts |= {key: key for key in ("fastest_pole", "anti_windup", "family", "loads") if key in section}
    parts |= {"tolerance": "tolerance"} if "tolerance" in goals else {}
    parts |= {WEIGHTS: "a weight in tolerance"} if any(errors) else {}
    measured = section.get("measured")
    if isinstance(measured, list) and "lag" not in parts and (forces := [name for name in measured if name in inputs]):
        parts["force"] = f"measured = {short_repr(forces[0])}"
    return parts


def check_together(where: str, parts: Mapping[str, str]) -> None:
    """Checks that the parts of a controller's section can be combined.

    Args:
        where: name of the section, for the message.
        parts: parts of the controller's section as written in the file; the type of the controller comes first.

    Raises:
        InputError: two parts cannot be combined. The message gives the reason and lists, for each of the two parts, options
            with which this part can be combined.
    """
    for one, other in combinations(parts, 2):
        if why := refusal(one, other):
            choice = " or ".join(_with_partners(part, beside, parts[part]) for part, beside in ((one, other), (other, one)))
            raise InputError(f"{where} {parts[one]} cannot be combined with {parts[other]}: {why}; choose {choice}")


def check_command(where: str, parts: Mapping[str, str], command: str, error: type[InputError] = InputError) -> None:
    """Checks that a command can be combined with all parts of a controller's section.

    Args:
        where: name of the section, for the message.
        parts: parts of the controller's section as written in the file.
        command: name of a command, a key of `COMMANDS`.
        error: class of the error to raise.

    Raises:
        InputError: the command cannot be combined with a part; the class of the error is `error`.
    """
    option = COMMANDS[command].strip("`")
    for part, written in parts.items():
        if why := refusal(command, part):
            raise error(f"{where}: {written} cannot be combined with {option}: {why}; omit {option} or {written}")


def _with_partners(part: str, other: str, written: str) -> str:
    """Returns a text that names a part, and lists options with which this part can be combined instead of `other`.

    Args:
        part: part to describe.
        other: name of the part with which `part` cannot be combined.
        written: the part as written in the section.
    """
    if {part, other} <= KINDS.keys():
        return written
    names = KINDS if other in KINDS else DEMANDS
    partners = [name.replace("`", "") for one, name in names.items() if one != part and not refusal(part, one)]
    return f"{written} (works with {', '.join(partners)})" if partners else written
