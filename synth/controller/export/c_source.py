"""C99 of an exported law: no heap, no library, a fixed order of summation, every name with the law's prefix."""

from collections.abc import Sequence
from textwrap import indent

import numpy as np

from models.common.arrays import Array
from synth.controller.export.c_law import LARGEST, NEAREST, STILL, ExportedLaw

FLAGS = "-std=c99 -O2 -ffp-contract=off"

# By the name of a law: its coefficient `c` from velocities of body and wheel, their difference `v`, and a third reading.
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

VALID = """/* Copies a finite value. Returns 1, and copies nothing, if the value is infinite or not a number. */
static int PREFIX_fault(NUMBER value, NUMBER *copy)
{
    int fault = 1;

    if ((value < MOST) && (-value < MOST))
    {
        *copy = value;
        fault = 0;
    }
    return fault;
}
"""
CLIPPED = """static NUMBER PREFIX_clipped(NUMBER value, NUMBER low, NUMBER high)
{
    NUMBER result = value;

    if (value < low)
    {
        result = low;
    }
    else if (value > high)
    {
        result = high;
    }
    else
    {
        /* as it is */
    }
    return result;
}
"""
QUANTISED = """/* The nearest step, of two the even one; what is too large for a fraction is a step already. */
static NUMBER PREFIX_quantised(NUMBER value, NUMBER step)
{
    NUMBER count = value / step;

    if ((count >= ZERO) && (count < LARGE))
    {
        volatile NUMBER sum = count + LARGE;
        count = sum - LARGE;
    }
    else if ((count < ZERO) && (count > -LARGE))
    {
        volatile NUMBER sum = count - LARGE;
        count = sum + LARGE;
    }
    else
    {
        /* as it is */
    }
    return step * count;
}
"""
SUM = """/* Adds a row times a column, from the first entry to the last. */
static NUMBER PREFIX_sum(NUMBER start, const NUMBER *row, const NUMBER *column, int count)
{
    NUMBER total = start;
    int i;

    for (i = 0; i < count; i++)
    {
        total = total + (row[i] * column[i]);
    }
    return total;
}
"""


class CSource:
    """Texts of the header, the source and the tables of a law."""

    def __init__(self, law: ExportedLaw, certificate: str) -> None:
        """Prepares a law, with the SHA-256 of its certificate's file."""
        self.law, self.certificate, self.p = law, certificate, law.name
        self.ctype, self.include, self.in_units, self.out_units = law.numbers, "", law.units, law.output_units

    @property
    def files(self) -> dict[str, str]:
        """Header, source and tables, by the names of their files."""
        return {f"{self.p}.h": self.header(), f"{self.p}.c": self.source(), f"{self.p}_data.h": self.data()}

    def number(self, value: float) -> str:
        """Returns the shortest literal that is read as this number."""
        own = (np.float32 if self.law.numbers == "float" else np.float64)(value)
        if not np.isfinite(own):
            return "0.0"  # no table holds one
        text = np.format_float_scientific(own, unique=True, trim="0")
        return text + ("f" if self.law.numbers == "float" else "")

    def header(self) -> str:
        """Returns NAME.h."""
        law, p, number = self.law, self.p, self.ctype
        guard = f"{p.upper()}_H"
        ins = "".join(f"    {number} {name}; /* {unit} */\n" for name, unit in zip(law.inputs, self.in_units, strict=True))
        outs = "".join(f"    {number} {name}; /* {unit} */\n" for name, unit in zip(law.outputs, self.out_units, strict=True))
        state = f"    {number} x[{law.states}];\n" if law.states else ""
        state += f"    {number} line[{law.delay}][{len(law.outputs)}];\n    int oldest;\n" if law.delay else ""
        if law.fixed is None:
            state += f"    {number} valid[{len(law.inputs)}]; /* the last finite inputs */\n"
            state += "    int faults; /* inputs, outputs and states of the last step that were not finite */\n"
        state = state or "    int unused; /* the law keeps nothing; C99 has no empty struct */\n"
        seconds = "" if law.period is None else CSource.number(self, law.period)
        period = f"#define {p.upper()}_SAMPLE_PERIOD {seconds} /* s */\n\n" if seconds else ""
        return (
            f"/* Controller {law.controller}. Units, signs and the order of calls stand in README.md of this folder. */\n"
            f"#ifndef {guard}\n#define {guard}\n\n{self.include}{period}"
            f"typedef struct\n{{\n{state}}} {p}_state;\n\ntypedef struct\n{{\n{ins}}} {p}_in;\n\n"
            f"typedef struct\n{{\n{outs}}} {p}_out;\n\n"
            f"/* SHA-256 of certificate.json. */\nextern const char {p}_certificate[65];\n\n"
            f"void {p}_init({p}_state *state);\nvoid {p}_step({p}_state *state, const {p}_in *in, {p}_out *out);\n\n#endif\n"
        )

    def table(self, name: str, matrix: Array) -> str:
        """Returns a table, one row a line."""
        rows = ",\n    ".join("{" + ", ".join(self.number(value) for value in row) + "}" for row in matrix)
        return f"static const {self.ctype} {self.p}_{name}[{len(matrix)}][{matrix.shape[1]}] = {{\n    {rows}}};\n"

    def data(self) -> str:
        """Returns NAME_data.h."""
        law, guard = self.law, f"{self.p.upper()}_DATA_H"
        tables = {"A": law.A, "B": law.B, "C": law.C, "D": None if law.semi_active else law.D, "L": law.anti_windup}
        text = "\n".join(self.table(name, one) for name, one in tables.items() if one is not None and one.size)
        if law.dampers:
            text += "\n/* nominal, least and largest coefficient beyond it [N s/m] */\n" + self.table(
                "dampers", np.array(law.dampers)
            )
        return (
            f"/* Tables of controller {law.controller}; included by {self.p}.c alone. */\n"
            f"#ifndef {guard}\n#define {guard}\n\n{text}"
            f'\nconst char {self.p}_certificate[65] = "{self.certificate}";\n\n#endif\n'
        )

    def source(self) -> str:
        """Returns NAME.c."""
        law, p = self.law, self.p
        body = [f'#include "{p}.h"\n#include "{p}_data.h"\n', self._filled(VALID)]
        clips = law.limit is not None or bool(law.dampers)
        if clips:
            body.append(self._filled(CLIPPED))
        if np.any(law.resolution):
            body.append(self._filled(QUANTISED))
        if not law.semi_active:
            body.append(self._filled(SUM))
        body += [self._init(), self._step()]
        return "\n".join(body)

    def _filled(self, text: str) -> str:
        """Returns a template with this law's prefix, numbers and constants."""
        words = {
            "PREFIX": self.p,
            "NUMBER": self.law.numbers,
            "ZERO": self.number(0),
            "LARGE": self.number(NEAREST[self.law.numbers]),
            "MOST": self.number(LARGEST[self.law.numbers]),
        }
        for word, own in words.items():
            text = text.replace(word, own)
        return text

    def _init(self) -> str:
        law, p, lines, m = self.law, self.p, list[str](), len(self.law.outputs)
        if law.states:
            lines.append(f"for (i = 0; i < {law.states}; i++)\n{{\n    state->x[i] = {self.number(0)};\n}}")
        if law.delay:
            still = f"{p}_dampers[i][0]" if law.dampers else self.number(0)
            lines.append(
                f"for (k = 0; k < {law.delay}; k++)\n{{\n    for (i = 0; i < {m}; i++)\n    {{\n"
                f"        state->line[k][i] = {still};\n    }}\n}}\nstate->oldest = 0;"
            )
        if law.fixed is None:
            lines.append(f"for (i = 0; i < {len(law.inputs)}; i++)\n{{\n    state->valid[i] = {self.number(0)};\n}}")
            lines.append("state->faults = 0;")
        declared = "int i;\n" * bool(lines) + "int k;\n" * bool(law.delay) + "\n" * bool(lines)
        inner = declared + ("\n".join(lines) if lines else "state->unused = 0;")
        return f"void {p}_init({p}_state *state)\n{{\n{indent(inner, '    ')}\n}}\n"

    def _step(self) -> str:
        law, p, number, m, q = self.law, self.p, self.law.numbers, len(self.law.outputs), self.law.readings
        zero, lines = self.number(0), [f"{number} y[{q}];", f"{number} computed[{m}];"]
        if law.dampers and not law.semi_active:
            lines.append(f"{number} closing[{m}];")
        if law.anti_windup is not None:
            lines.append(f"{number} missing[{m}];")
        if law.states:
            lines.append(f"{number} next[{law.states}];")
        if not law.semi_active or law.delay:
            lines.append("int i;")
        lines += ["", "state->faults = 0;"]
        lines += [f"state->faults += {p}_fault(in->{name}, &state->valid[{i}]);" for i, name in enumerate(law.inputs)]
        for i, step in enumerate(law.resolution):
            seen = f"state->valid[{i}]"
            lines.append(f"y[{i}] = {f'{p}_quantised({seen}, {self.number(step)})' if step else seen};")
        if law.dampers and not law.semi_active:
            still = self.number(STILL[law.numbers])
            for j in range(len(law.inputs) - q):
                seen = f"state->valid[{q + j}]"
                lines.append(f"closing[{j}] = ({seen} == {zero}) ? {still} : -{seen};")
        lines += self._semi_active() if law.semi_active else self._linear()
        return self._ended(lines)

    def _ended(self, lines: list[str]) -> str:
        """Returns the step function of lines that compute the outputs, with its delay."""
        law, p, m = self.law, self.p, len(self.law.outputs)
        if law.delay:
            lines += [f"out->{name} = state->line[state->oldest][{j}];" for j, name in enumerate(law.outputs)]
            lines += [f"for (i = 0; i < {m}; i++)\n{{\n    state->line[state->oldest][i] = computed[i];\n}}"]
            lines += [f"state->oldest = (state->oldest + 1) % {law.delay};"]
        else:
            lines += [f"out->{name} = computed[{j}];" for j, name in enumerate(law.outputs)]
        if law.fixed is not None and not (law.states or law.delay):
            lines.append("(void)state;")
        inner = "\n".join(lines)
        return f"void {p}_step({p}_state *state, const {p}_in *in, {p}_out *out)\n{{\n{indent(inner, '    ')}\n}}\n"

    def _linear(self) -> Sequence[str]:
        law, p, number, m, q, k = self.law, self.p, self.law.numbers, len(self.law.outputs), self.law.readings, self.law.states
        zero = self.number(0)
        inner = [f"{number} force = {zero};", f"{number} total = {p}_sum({zero}, {p}_D[i], y, {q});", ""]
        if k:
            inner.append(f"total = {p}_sum(total, {p}_C[i], state->x, {k});")
        inner.append(f"state->faults += {p}_fault(total, &force);")
        given = "computed[i]"
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
        if law.anti_windup is not None:
            inner.append(f"missing[i] = {given} - force;")
        lines = [f"for (i = 0; i < {m}; i++)\n{{\n" + indent("\n".join(inner), "    ") + "\n}"]
        if k:
            after = [f"next[i] = {p}_sum({zero}, {p}_A[i], state->x, {k});", f"next[i] = {p}_sum(next[i], {p}_B[i], y, {q});"]
            if law.anti_windup is not None:
                after.append(f"next[i] = {p}_sum(next[i], {p}_L[i], missing, {m});")
            lines.append(f"for (i = 0; i < {k}; i++)\n{{\n" + indent("\n".join(after), "    ") + "\n}")
            lines.append(
                f"for (i = 0; i < {k}; i++)\n{{\n    state->x[i] = {zero};\n"
                f"    state->faults += {p}_fault(next[i], &state->x[i]);\n}}"
            )
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
        """Returns test/main.c, which holds the code against test/vectors.csv."""
        law, p = self.law, self.p
        read = {"float": "strtof(at, &at)", "double": "strtod(at, &at)"}.get(law.numbers, f"({self.ctype})strtol(at, &at, 10)")
        ins = "\n".join(f"        in.{name} = {read}; at++;" for name in law.inputs)
        outs = "\n".join(f"        differ += (out.{name} != {read}) ? 1L : 0L; at++;" for name in law.outputs)
        longest = 40 * (len(law.inputs) + len(law.outputs)) + 200
        return f"""/* Runs vectors.csv through the code, back to back: every output must have the bits of the file. */
#include <stdio.h>
#include <stdlib.h>
#include "../{p}.h"

int main(int argc, char **argv)
{{
    static char line[{longest}];
    {p}_state state;
    {p}_in in;
    {p}_out out;
    long samples = 0L;
    long differ = 0L;
    FILE *file = fopen((argc > 1) ? argv[1] : "vectors.csv", "r");

    if ((file == NULL) || (fgets(line, (int)sizeof line, file) == NULL))
    {{
        (void)fprintf(stderr, "vectors.csv cannot be read; give its path\\n");
        return 2;
    }}
    {p}_init(&state);
    while (fgets(line, (int)sizeof line, file) != NULL)
    {{
        char *at = line;

{ins}
        {p}_step(&state, &in, &out);
{outs}
        samples++;
    }}
    (void)fclose(file);
    (void)printf("%ld samples, %ld outputs differ\\n", samples, differ);
    return (differ == 0L) ? 0 : 1;
}}
"""

    def cmake(self) -> str:
        """Returns CMakeLists.txt: a library, and its test."""
        p = self.p
        return f"""cmake_minimum_required(VERSION 3.10)
project({p} C)
set(CMAKE_C_STANDARD 99)
set(CMAKE_C_EXTENSIONS OFF)
if(CMAKE_C_COMPILER_ID MATCHES "GNU|Clang")
  add_compile_options(-ffp-contract=off) # a fused multiply-add rounds once where two operations round twice
endif()
add_library({p} {p}.c)
target_include_directories({p} PUBLIC ${{CMAKE_CURRENT_SOURCE_DIR}})
enable_testing()
add_executable({p}_test test/main.c)
target_link_libraries({p}_test {p})
add_test(NAME {p} COMMAND {p}_test ${{CMAKE_CURRENT_SOURCE_DIR}}/test/vectors.csv)
"""
