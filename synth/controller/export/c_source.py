"""C99 source of an exported law. The code uses no heap and no library, adds numbers in a fixed order, and gives every name a
prefix.

Fixed-point code uses only integers. Sums have 64 bits, and every result is clipped so that it cannot overflow.
"""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from textwrap import indent

import numpy as np

from models.common.arrays import Array
from synth.controller.export.c_law import LARGEST, NEAREST, STILL, ExportedLaw

FLAGS = "-std=c99 -O2 -ffp-contract=off"

# C source of each law, by name. The source computes the damping coefficient `c` from the velocities of body and wheel, the
# difference `v` of these velocities, and a third measurement
SEMI_ACTIVE = {
    "skyhook": "c = ((body * v) > ZERO) ? C_MAX : C_MIN;",
    "skyhook_linear": "c = ((body * v) > ZERO) ? (-(-SKY * body) / over) : C_MIN;",
    "groundhook": "c = ((-wheel * v) > ZERO) ? C_MAX : C_MIN;",
    "hybrid": "const NUMBER sky = ((body * v) > ZERO) ? (-SKY * body) : ZERO;\n"
    "const NUMBER ground = ((-wheel * v) > ZERO) ? (GROUND * wheel) : ZERO;\n"
    "c = -((MIX * sky) + ((ONE - MIX) * ground)) / over;",
    "add": "c = ((third * v) > ZERO) ? C_MAX : C_MIN;",
    "pdd": "const NUMBER spring = STIFFNESS * third;\n"
    "if ((v == ZERO) && (spring != ZERO))\n{\n    c = (C_MIN + C_MAX) / TWO;\n}\n"
    "else if (((spring * v) + (C_MIN * (v * v))) >= ZERO)\n{\n    c = C_MIN;\n}\n"
    "else if (((spring * v) + (C_MAX * (v * v))) < ZERO)\n{\n    c = C_MAX;\n}\n"
    "else\n{\n    c = -spring / over;\n}",
    "skyhook_add": "if ((third * third) <= ((CROSSOVER * CROSSOVER) * (body * body)))\n"
    "{\n    c = ((body * v) > ZERO) ? C_MAX : C_MIN;\n}\nelse\n{\n    c = ((third * v) > ZERO) ? C_MAX : C_MIN;\n}",
    "skyhook_modal": "c = ((damped * v) > ZERO) ? (-(-SKY * damped) / over) : C_MIN;",
}
THIRD = ("add", "pdd", "skyhook_add")

HERE = Path(__file__).parent / "c"  # folder with C templates, in which words in capitals are replaced


def literal(numbers: str, value: float) -> str:
    """Returns the shortest C literal of type "double" or "float" that a compiler reads as exactly this number."""
    own = (np.float32 if numbers == "float" else np.float64)(value)
    if not np.isfinite(own):
        return "0.0"  # this case does not occur: no table contains infinity or NaN
    return np.format_float_scientific(own, unique=True, trim="0") + ("f" if numbers == "float" else "")


def _loop(count: int, *lines: str) -> str:
    """Returns a C loop over the index i whose body consists of the given lines."""
    return f"for (i = 0; i < {count}; i++)\n{{\n" + indent("\n".join(lines), "    ") + "\n}"


def _function(head: str, lines: Sequence[str]) -> str:
    return f"{head}\n{{\n" + indent("\n".join(lines), "    ") + "\n}\n"


class CSource:
    """C code of a law: header, source and tables."""

    def __init__(self, law: ExportedLaw, certificate: str) -> None:
        """Prepares the C source of a law.

        Args:
            law: exported law.
            certificate: SHA-256 of the certificate file.
        """
        self.law, self.certificate, self.p, self.fixed = law, certificate, law.name, law.fixed
        self.ctype, self.total, self.in_units, self.out_units = law.numbers, law.numbers, law.units, law.output_units
        if (of := law.fixed) is not None:
            self.ctype, self.total = f"{law.numbers}_t", "int64_t"
            self.in_units, self.out_units = (
                tuple(f"{unit}, in steps of {scale!r}" for unit, scale in zip(units, scales.tolist(), strict=True))
                for units, scales in ((law.units, of.seen), (law.output_units, of.given))
            )
        self.zero = self.number(0)

    @property
    def files(self) -> dict[str, str]:
        """Texts of header, source and tables, by file name."""
        return {f"{self.p}.h": self.header(), f"{self.p}.c": self.source(), f"{self.p}_data.h": self.data()}

    def number(self, value: float) -> str:
        """Returns a number as a C literal in the number format of the law."""
        return literal(self.law.numbers, value) if self.fixed is None else str(int(value))

    def header(self) -> str:
        """Returns the text of NAME.h."""
        law, p, number = self.law, self.p, self.ctype
        guard = f"{p.upper()}_H"
        ins = "".join(f"    {number} {name}; /* {unit} */\n" for name, unit in zip(law.inputs, self.in_units, strict=True))
        outs = "".join(f"    {number} {name}; /* {unit} */\n" for name, unit in zip(law.outputs, self.out_units, strict=True))
        state = f"    {number} x[{law.states}];\n" if law.states else ""
        state += f"    {number} given[{len(law.outputs)}]; /* the last forces, without delay */\n" * (law.change is not None)
        state += f"    {number} line[{law.delay}][{len(law.outputs)}];\n    int oldest;\n" if law.delay else ""
        if self.fixed is None:
            state += f"    {number} valid[{len(law.inputs)}]; /* the last finite inputs */\n"
            state += "    int faults; /* inputs, outputs and states of the last step that were not finite */\n"
        state = state or "    int unused; /* the law has no state; C99 has no empty struct */\n"
        include = "" if self.fixed is None else "#include <stdint.h>\n\n"
        if law.period is not None:
            include += f"#define {p.upper()}_SAMPLE_PERIOD {literal(law.numbers, law.period)} /* s */\n\n"
        return (
            f"/* Controller {law.controller}. Units, signs and the order of calls are in README.md of this folder. */\n"
            f"#ifndef {guard}\n#define {guard}\n\n{include}"
            f"typedef struct\n{{\n{state}}} {p}_state;\n\ntypedef struct\n{{\n{ins}}} {p}_in;\n\n"
            f"typedef struct\n{{\n{outs}}} {p}_out;\n\n"
            f"/* SHA-256 of certificate.json. */\nextern const char {p}_certificate[65];\n\n"
            f"void {p}_init({p}_state *state);\nvoid {p}_step({p}_state *state, const {p}_in *in, {p}_out *out);\n\n#endif\n"
        )

    def _row(self, values: Iterable[float]) -> str:
        return "{" + ", ".join(map(self.number, values)) + "}"

    def _table(self, name: str, matrix: Array) -> str:
        """Returns a C table with one matrix row per line."""
        rows = ",\n    ".join(map(self._row, matrix))
        return f"static const {self.ctype} {self.p}_{name}[{len(matrix)}][{matrix.shape[1]}] = {{\n    {rows}}};\n"

    def data(self) -> str:
        """Returns the text of NAME_data.h."""
        law, p, guard = self.law, self.p, f"{self.p.upper()}_DATA_H"
        tables = {} if law.semi_active else law.tables
        text = "\n".join(self._table(name, one) for name, one in tables.items() if one.size)
        if law.dampers:
            dampers = self._table("dampers", np.array(law.dampers))
            text += f"\n/* nominal coefficient; smallest and largest difference from it [N s/m] */\n{dampers}"
        if (of := self.fixed) is not None:
            row = self._row(of.shifts)
            text += f"\n/* the sum of a row is divided by 2^shift */\nstatic const int {p}_shift[{len(of.shifts)}] = {row};\n"
        ends = () if of is None else (("limit", "forces", of.limit), ("change", "changes of the forces per sample", of.change))
        for name, what, most in ends:
            if most is not None:
                text += f"\n/* largest {what} */\nstatic const {self.ctype} {p}_{name}[{len(most)}] = {self._row(most)};\n"
        return (
            f"/* Tables of controller {law.controller}; included by {p}.c alone. */\n"
            f"#ifndef {guard}\n#define {guard}\n\n{text}"
            f'\nconst char {p}_certificate[65] = "{self.certificate}";\n\n#endif\n'
        )

    def source(self) -> str:
        """Returns the text of NAME.c."""
        law, floating = self.law, self.fixed is None
        parts = {
            "fault.c": floating,
            "clipped.c": floating and (law.limit is not None or law.change is not None or bool(law.dampers)),
            "quantised.c": floating and bool(np.any(law.resolution)),
            "sum.c": not law.semi_active,
            "rounded.c": not floating,
        }
        words = {
            "NUMBER": self.ctype,
            "TOTAL": self.total,
            "PRODUCT": "row[i] * column[i]" if floating else "(int64_t)row[i] * (int64_t)column[i]",
            "ZERO": self.zero,
            "LARGE": self.number(NEAREST.get(law.numbers, 0)),
            "MOST": self.number(LARGEST.get(law.numbers, 0)),
        }
        text = "\n".join(self.template(name, **words) for name, needed in parts.items() if needed)
        return "\n".join([f'#include "{self.p}.h"\n#include "{self.p}_data.h"\n', text, self._init(), self._step()])

    def template(self, name: str, **words: str) -> str:
        """Returns the text of a template file in the folder `c`. In this text, `PREFIX` is replaced by the name of the law, and
        each key of `words` by its value.
        """
        own = {"PREFIX": self.p, **words}
        return re.sub("|".join(own), lambda found: own[found[0]], (HERE / name).read_text(encoding="utf-8"))

    def _init(self) -> str:
        law, p, lines = self.law, self.p, list[str]()
        if law.states:
            lines.append(_loop(law.states, f"state->x[i] = {self.zero};"))
        if law.change is not None:
            lines.append(_loop(len(law.outputs), f"state->given[i] = {self.zero};"))
        if law.delay:
            still = f"{p}_dampers[i][0]" if law.dampers else self.zero
            inner = indent(_loop(len(law.outputs), f"state->line[k][i] = {still};"), "    ")
            lines += [f"for (k = 0; k < {law.delay}; k++)\n{{\n{inner}\n}}", "state->oldest = 0;"]
        if self.fixed is None:
            lines += [_loop(len(law.inputs), f"state->valid[i] = {self.zero};"), "state->faults = 0;"]
        declared = ["int i;", *["int k;"] * bool(law.delay), ""]
        return _function(f"void {p}_init({p}_state *state)", [*declared, *lines] if lines else ["state->unused = 0;"])

    def _step(self) -> str:
        law, p, number, m, q = self.law, self.p, self.ctype, len(self.law.outputs), self.law.readings
        on_dampers = bool(law.dampers) and not law.semi_active
        sizes = {
            "y": q,
            "computed": m,
            "closing": m * on_dampers,
            "missing": m * (law.anti_windup is not None),
            "next": law.states,
        }
        lines = [f"{number} {name}[{size}];" for name, size in sizes.items() if size]
        lines += ["int i;"] * (not law.semi_active or law.delay > 0) + [""]
        if self.fixed is not None:
            most = self.number(self.fixed.largest)
            lines += [f"y[{i}] = {p}_rounded((int64_t)in->{name}, 0, {most});" for i, name in enumerate(law.inputs)]
        else:
            lines.append("state->faults = 0;")
            lines += [f"state->faults += {p}_fault(in->{name}, &state->valid[{i}]);" for i, name in enumerate(law.inputs)]
            for i, step in enumerate(law.resolution):
                seen = f"state->valid[{i}]"
                lines.append(f"y[{i}] = {f'{p}_quantised({seen}, {self.number(step)})' if step else seen};")
            for j in range((len(law.inputs) - q) * on_dampers):
                seen, still = f"state->valid[{q + j}]", self.number(STILL[law.numbers])
                lines.append(f"closing[{j}] = ({seen} == {self.zero}) ? {still} : -{seen};")
        lines += self._semi_active() if law.semi_active else self._linear()
        if law.delay:
            lines += [f"out->{name} = state->line[state->oldest][{j}];" for j, name in enumerate(law.outputs)]
            lines.append(_loop(m, "state->line[state->oldest][i] = computed[i];"))
            lines.append(f"state->oldest = (state->oldest + 1) % {law.delay};")
        else:
            lines += [f"out->{name} = computed[{j}];" for j, name in enumerate(law.outputs)]
        if self.fixed is not None and not (law.states or law.delay or law.change is not None):
            lines.append("(void)state;")
        return _function(f"void {p}_step({p}_state *state, const {p}_in *in, {p}_out *out)", lines)

    def _sums(self, total: str, *products: tuple[str, str, int]) -> list[str]:
        """Returns lines of C that add the products of row i of each table with a vector.

        Args:
            total: name of the C variable for the sum.
            products: name of the table, name of the vector, and number of entries of the vector, for each product. Empty vectors
                are omitted.
        """
        start, lines = "0" if self.fixed is not None else self.zero, list[str]()
        for table, vector, count in products:
            if count:
                lines.append(f"{total} = {self.p}_sum({total if lines else start}, {self.p}_{table}[i], {vector}, {count});")
        return lines

    def _linear(self) -> Sequence[str]:
        law, p, number, m, q, k = self.law, self.p, self.ctype, len(self.law.outputs), self.law.readings, self.law.states
        first, *more = self._sums("total", ("D", "y", q), ("C", "state->x", k))
        inner, given = [f"{self.total} {first}", "", *more], "computed[i]"
        if self.fixed is not None:
            most = self.number(self.fixed.largest)
            top = most if law.limit is None else f"(int64_t){p}_limit[i]"
            inner.append(f"computed[i] = {p}_rounded(total, {p}_shift[i], {top});")
            missing = f"({number})(computed[i] - {p}_rounded(total, {p}_shift[i], {most}))"
            if law.change is not None:
                change = f"{p}_rounded((int64_t)computed[i] - state->given[i], 0, {p}_change[i])"
                inner += [f"computed[i] = ({number})(state->given[i] + {change});", "state->given[i] = computed[i];"]
        else:
            inner = [f"{number} force = {self.zero};", *inner, f"state->faults += {p}_fault(total, &force);"]
            if law.dampers:
                inner += [
                    f"const {number} beyond = {p}_clipped(force / closing[i], {p}_dampers[i][1], {p}_dampers[i][2]);",
                    f"computed[i] = {p}_dampers[i][0] + beyond;",
                ]
                given = "(beyond * closing[i])"
            elif law.limit is not None:
                inner.append(f"computed[i] = {p}_clipped(force, {self.number(-law.limit)}, {self.number(law.limit)});")
            else:
                inner.append("computed[i] = force;")
            if law.change is not None:
                change = self.number(law.change)
                ends = f"state->given[i] - {change}, state->given[i] + {change}"
                inner += [f"computed[i] = {p}_clipped(computed[i], {ends});", "state->given[i] = computed[i];"]
            missing = f"{given} - force"
        inner += [f"missing[i] = {missing};"] * (law.anti_windup is not None)
        lines = [_loop(m, *inner)]
        if k:
            products = ("A", "state->x", k), ("B", "y", q), ("L", "missing", m * (law.anti_windup is not None))
            if self.fixed is not None:
                first, *more = self._sums("total", *products)
                kept = f"next[i] = {p}_rounded(total, {p}_shift[i + {m}], {self.number(self.fixed.largest)});"
                lines += [_loop(k, f"int64_t {first}", *more, kept), _loop(k, "state->x[i] = next[i];")]
            else:
                lines.append(_loop(k, *self._sums("next[i]", *products)))
                lines.append(_loop(k, f"state->x[i] = {self.zero};", f"state->faults += {p}_fault(next[i], &state->x[i]);"))
        return lines

    def _semi_active(self) -> Sequence[str]:
        law, p, number, m = self.law, self.p, self.law.numbers, len(self.law.outputs)
        assert law.coefficients is not None, "the law is semi-active"
        blocks = []
        for j in range(m):
            of, seen = law.coefficients.alone(j), [*range(law.modes), *range(law.modes + j, law.readings, m)]
            replaced = {"ZERO": 0.0, "ONE": 1.0, "TWO": 2.0, "C_MIN": of.c_min, "C_MAX": of.c_max, "SKY": of.sky}
            replaced |= {"GROUND": of.ground, "STIFFNESS": of.stiffness, "MIX": of.mix, "CROSSOVER": of.crossover}
            lines = []
            if law.modes:
                lines += [f"{number} damped = {self.number(0)};", f"{number} moved = {self.number(0)};"]
                wheel = seen[-1]
            else:
                lines.append(f"const {number} body = y[{seen[0]}];")
                wheel = seen[1]
            lines.append(f"const {number} wheel = y[{wheel}];")
            lines += [f"{number} v;", f"{number} c;"]
            for at, (damped, moved) in enumerate(zip(*of.modes, strict=True)):
                lines.append(f"damped = damped + ({self.number(damped)} * y[{at}]);")
                lines.append(f"moved = moved + ({self.number(moved)} * y[{at}]);")
            lines.append(f"v = {'moved' if law.modes else 'body'} - wheel;")
            text = SEMI_ACTIVE[law.semi_active]
            if "over" in text:
                lines.insert(2 if not law.modes else 3, f"{number} over;")
                lines.append(f"over = (v == {self.number(0)}) ? {self.number(STILL[law.numbers])} : v;")
            if law.semi_active in THIRD:
                lines.insert(0, f"const {number} third = y[{seen[2]}];")
            text = text.replace("NUMBER", number)
            for word in sorted(replaced, key=len, reverse=True):
                text = text.replace(word, self.number(replaced[word]))
            nominal, low_high = f"{p}_dampers[{j}][0]", f"{p}_dampers[{j}][1], {p}_dampers[{j}][2]"
            lines += [*text.split("\n"), f"computed[{j}] = {nominal};", f"state->faults += {p}_fault(c, &computed[{j}]);"]
            lines.append(f"computed[{j}] = {p}_clipped(computed[{j}] - {nominal}, {low_high}) + {nominal};")
            blocks.append("{\n" + indent("\n".join(lines), "    ") + "\n}")
        return blocks

    def main(self) -> str:
        """Returns the text of test/main.c, which compares the code with test/vectors.csv."""
        law = self.law
        read = {"float": "strtof(at, &at)", "double": "strtod(at, &at)"}.get(law.numbers, f"({self.ctype})strtol(at, &at, 10)")
        ins = "\n".join(f"        in.{name} = {read}; at++;" for name in law.inputs)
        outs = "\n".join(f"        differ += (out.{name} != {read}) ? 1L : 0L; at++;" for name in law.outputs)
        longest = 40 * (len(law.inputs) + len(law.outputs)) + 200
        return self.template("main.c", LONGEST=str(longest), INPUTS=ins, OUTPUTS=outs)

    def cmake(self) -> str:
        """Returns the text of CMakeLists.txt, which builds a library and its test."""
        return self.template("CMakeLists.txt")
