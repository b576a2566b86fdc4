"""C99 of a law in fixed point: integers alone, sums in 64 bits, and every result clipped instead of an overflow."""

from textwrap import indent

from models.common.arrays import Array
from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.c_source import CSource

ARITHMETIC = """/* Adds a row times a column, from the first entry to the last; 64 bits hold every sum. */
static int64_t PREFIX_sum(int64_t start, const NUMBER *row, const NUMBER *column, int count)
{
    int64_t total = start;
    int i;

    for (i = 0; i < count; i++)
    {
        total = total + ((int64_t)row[i] * (int64_t)column[i]);
    }
    return total;
}

/* A sum over 2^shift, to the nearest, of two the one away from 0; clipped to +-most. */
static NUMBER PREFIX_rounded(int64_t total, int shift, int64_t most)
{
    const int64_t half = (shift > 0) ? ((int64_t)1 << (shift - 1)) : 0;
    int64_t result = (total >= 0) ? ((total + half) >> shift) : -((half - total) >> shift);

    if (result > most)
    {
        result = most;
    }
    else if (result < -most)
    {
        result = -most;
    }
    else
    {
        /* as it is */
    }
    return (NUMBER)result;
}
"""


class FixedSource(CSource):
    """Texts of a law in fixed point."""

    def __init__(self, law: ExportedLaw, certificate: str) -> None:
        """Prepares a law, with the SHA-256 of its certificate's file."""
        super().__init__(law, certificate)
        assert law.fixed is not None, "it is in fixed point"
        self.fixed, self.ctype, self.include = law.fixed, f"{law.numbers}_t", "#include <stdint.h>\n\n"
        self.in_units = [f"{unit}, in steps of {scale!r}" for unit, scale in zip(law.units, law.fixed.seen.tolist(), strict=True)]
        self.out_units = [
            f"{unit}, in steps of {scale!r}" for unit, scale in zip(law.output_units, law.fixed.given.tolist(), strict=True)
        ]

    def number(self, value: float) -> str:
        """Returns an integer."""
        return str(int(value))

    def data(self) -> str:
        """Returns NAME_data.h."""
        law, of, (m, q, k) = self.law, self.fixed, (len(self.law.outputs), self.law.readings, self.law.states)
        guard = f"{self.p.upper()}_DATA_H"
        parts = {"D": of.rows[:m, :q], "C": of.rows[:m, q : q + k], "B": of.rows[m:, :q], "A": of.rows[m:, q : q + k]}
        if law.anti_windup is not None:
            parts["L"] = of.rows[m:, q + k :]
        text = "\n".join(self.table(name, one) for name, one in parts.items() if one.size)
        text += f"\n/* a row's sum is over 2^shift */\nstatic const int {self.p}_shift[{m + k}] = {self._row(of.shifts)};\n"
        if of.limit is not None:
            text += f"\n/* largest forces */\nstatic const {self.ctype} {self.p}_limit[{m}] = {self._row(of.limit)};\n"
        return (
            f"/* Tables of controller {law.controller}; included by {self.p}.c alone. */\n"
            f"#ifndef {guard}\n#define {guard}\n\n{text}"
            f'\nconst char {self.p}_certificate[65] = "{self.certificate}";\n\n#endif\n'
        )

    def _row(self, values: Array) -> str:
        return "{" + ", ".join(self.number(value) for value in values) + "}"

    def source(self) -> str:
        """Returns NAME.c."""
        arithmetic = ARITHMETIC.replace("PREFIX", self.p).replace("NUMBER", self.ctype)
        return "\n".join([f'#include "{self.p}.h"\n#include "{self.p}_data.h"\n', arithmetic, self._init(), self._step()])

    def _step(self) -> str:
        law, p, number, m = self.law, self.p, self.ctype, len(self.law.outputs)
        q, k, most = law.readings, law.states, self.number(self.fixed.largest)
        lines = [f"{number} y[{q}];", f"{number} computed[{m}];"]
        lines += [f"{number} missing[{m}];"] * (law.anti_windup is not None) + [f"{number} next[{k}];"] * bool(k) + ["int i;", ""]
        lines += [f"y[{i}] = {p}_rounded((int64_t)in->{name}, 0, {most});" for i, name in enumerate(law.inputs)]
        inner = [f"int64_t total = {p}_sum(0, {p}_D[i], y, {q});"]
        inner += [f"total = {p}_sum(total, {p}_C[i], state->x, {k});"] * bool(k)
        top = most if law.limit is None else f"(int64_t){p}_limit[i]"
        inner.append(f"computed[i] = {p}_rounded(total, {p}_shift[i], {top});")
        if law.anti_windup is not None:
            inner.append(f"missing[i] = ({number})(computed[i] - {p}_rounded(total, {p}_shift[i], {most}));")
        lines.append(f"for (i = 0; i < {m}; i++)\n{{\n" + indent("\n".join(inner), "    ") + "\n}")
        if k:
            after = [f"int64_t total = {p}_sum(0, {p}_A[i], state->x, {k});", f"total = {p}_sum(total, {p}_B[i], y, {q});"]
            after += [f"total = {p}_sum(total, {p}_L[i], missing, {m});"] * (law.anti_windup is not None)
            after.append(f"next[i] = {p}_rounded(total, {p}_shift[i + {m}], {most});")
            lines.append(f"for (i = 0; i < {k}; i++)\n{{\n" + indent("\n".join(after), "    ") + "\n}")
            lines.append(f"for (i = 0; i < {k}; i++)\n{{\n    state->x[i] = next[i];\n}}")
        return self._ended(lines)


def source_of(law: ExportedLaw, certificate: str) -> CSource:
    """Returns the texts of a law, with the SHA-256 of its certificate's file."""
    return CSource(law, certificate) if law.fixed is None else FixedSource(law, certificate)
