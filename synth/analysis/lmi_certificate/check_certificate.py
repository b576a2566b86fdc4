"""Checks an "LMI certificate 1" in exact rational arithmetic: python check_certificate.py FILE.json

Exit code: 0 if every claim is proved, 1 if a claim is not proved, 2 if the file is not a certificate or has an inexact claim.
"""

import json
import re
import sys
from fractions import Fraction
from itertools import product
from math import lcm
from pathlib import Path

NUMBER = re.compile(r"\A-?[0-9]{1,4000}(?:\.[0-9]{1,4000}|/0{0,9}[1-9][0-9]{0,3999})?\Z")
SHAPES = {"A": "xx", "B": "xu", "Bw": "xw", "C": "zx", "D": "zu", "Dw": "zw", "Cy": "yx", "Dyu": "yu", "Dyw": "yw"}
SIGNALS = {"x": "states", "u": "inputs", "w": "disturbances", "z": "outputs", "y": "measurements"}
KINDS = ("stability", "decay", "norm", "energy_to_peak", "lower_bound", "invariant_point", "box")

class Matrix:
    """Matrix of rational numbers, stored as rows. A | B stacks A above B."""
    T = property(lambda self: Matrix(zip(*self.rows, strict=True)))  # transposes the matrix
    square = property(lambda self: sum(x * x for row in self.rows for x in row))  # sum of the squares of all entries
    def __init__(self, rows):
        self.rows = [list(row) for row in rows]
    def __or__(self, other):
        return Matrix(self.rows + other.rows)
    def __add__(self, other):
        return Matrix([x + y for x, y in zip(*rows, strict=True)] for rows in zip(self.rows, other.rows, strict=True))
    def __mul__(self, k):
        return Matrix([k * x for x in row] for row in self.rows)
    def __matmul__(self, other):
        return Matrix([sum(x * y for x, y in zip(row, c, strict=True) if x and y) for c in other.T.rows] for row in self.rows)

    def positive(self, semidefinite=False):
        """Returns True if M = M' is positive (semi)definite: the pivots of Bareiss elimination are the leading minors of M."""
        over, before = lcm(*(x.denominator for row in self.rows for x in row)), 1
        a = [[x.numerator * (over // x.denominator) for x in row] for row in self.rows]
        for k, top in enumerate(a):
            if top[k] < 0 or (top[k] == 0 and not (semidefinite and not any(top[k:]))):
                return False
            for i in range(k + 1, len(a)) if top[k] else ():
                a[i][i:] = [(top[k] * x - top[i] * y) // before for x, y in zip(a[i][i:], top[i:], strict=True)]
            before = top[k] or before
        return self.T.rows == self.rows

def read(value):
    """Returns a string such as "-3", "0.25" or "22/7" as a number, or a nested list of such strings as a matrix."""
    if isinstance(value, list):
        return Matrix(map(read, row) for row in value)
    return Fraction("".join(NUMBER.findall(value)))  # a value that is not a number becomes "", which Fraction rejects

def diagonal(entries):
    """Returns the diagonal matrix with these entries."""
    return Matrix([x * (i == j) for j in range(len(entries))] for i, x in enumerate(entries))

class ExactLoop:
    """Loop u = K y of a plant p, with S = [A; C] and W = [Bw; Dw] of the loop, E = [I; 0] and det = det(I - K Dyu)."""

    def __init__(self, p, K):
        self.p, self.K, m, self.I, self.det = p, K, len(K.rows), diagonal([1] * len(p["A"].rows)), Fraction(1)
        a = [x + y for x, y in zip((diagonal([1] * m) + K @ p["Dyu"] * -1).rows, K.rows, strict=True)]
        for k in range(m):  # Gaussian elimination
            i = next((i for i in range(k, m) if a[i][k]), k)
            self.det *= a[i][k] * (-1) ** (i != k)
            a[i], a[k] = a[k], [Fraction(x) / a[i][k] for x in a[i]]
            a = [[x - row[k] * y for x, y in zip(row, a[k], strict=True)] if i != k else row for i, row in enumerate(a)]
        into, self.E = (p["B"] | p["D"]) @ Matrix(row[m:] for row in a), self.I | p["C"] * 0
        self.S, self.W = (p["A"] | p["C"]) + into @ p["Cy"], (p["Bw"] | p["Dw"]) + into @ p["Dyw"]

    def moved(self, S, X, E):
        """Returns S X E' + E X S', or S X S' - E X E' if the plant is sampled."""
        return S @ X @ S.T + E @ X @ E.T * -1 if self.p["sampled"] else S @ X @ E.T + E @ X @ S.T

    def decay(self, X, rate=None):
        """Returns True if all poles have Re s < -rate (sampled: |z| < rate): A X + X A' + 2 rate X < 0 < X. Default: stable."""
        A, rate = self.E.T @ self.S, Fraction(self.p["sampled"]) if rate is None else rate
        A = A * (1 / rate) if self.p["sampled"] else A + self.I * rate
        return rate >= 0 and X.positive() and (self.moved(A, X, self.I) * -1).positive()

    stability = decay

    def norm(self, X, bound):
        """Returns True if X > 0 and the bounded real lemma prove that the loop is stable with an H-infinity norm < bound."""
        outputs = diagonal([0] * len(X.rows) + [1] * len(self.p["C"].rows))
        F = self.moved(self.S, X, self.E) + self.W @ self.W.T * (1 / bound**2) + outputs * -1
        return bound > 0 and X.positive() and (F * -1).positive()

    def energy_to_peak(self, X, bound):
        """Returns True if |z| <= bound for every w of energy 1: A X + X A' + Bw Bw' < 0 < X, C X C' <= bound^2 I."""
        A, Bw, C = self.E.T @ self.S, self.E.T @ self.W, Matrix(self.S.rows[len(X.rows) :])
        lasting = (self.moved(A, X, self.I) + Bw @ Bw.T) * -1
        below = diagonal([bound**2] * len(C.rows)) + C @ X @ C.T * -1
        return bound >= 0 and self.W.square == Bw.square and X.positive() and lasting.positive() and below.positive(True)

    def lower_bound(self, bound, W1, W2, V12):
        """Returns True if W1 W1' and W2 W2' (dual solutions for X and X^-1) prove that no controller has a norm < bound."""
        sides, f = [], -sum(V12.rows[i][i] for i in range(len(V12.rows)))
        for W, turned, names in ((W1, False, "A B Bw C D Dw"), (W2, True, "A Cy C Bw Dyw Dw")):
            A, B, Bw, C, D, Dw = (self.p[name].T if turned else self.p[name] for name in names.split())
            E = self.I | C * 0
            sides += [self.moved((A | C).T, W @ W.T, E.T), W.square - (E.T @ W).square, ((Bw | Dw).T @ W).square]
            if ((B | D).T @ W).square:
                return False
        V1, t1, e1, V2, t2, e2 = sides
        V = Matrix(x + y for x, y in zip((V1 | V12.T).rows, (V12 | V2).rows, strict=True))
        a, b = t1 - e1 / bound**2, t2 * bound**2 - e2
        return bound > 0 and V.positive(True) and (a <= 0 < t1 or (f > 0 and a * b <= f * f))

    def invariant_point(self, bound, frequency, r):
        """Returns True if r* [A - s I, B; C, D] = 0 for r = [q; p], s on the axis. Then p* z = r* [Bw; Dw] w for any u."""
        p, t, q = self.p, frequency, r @ self.E
        s, turn = ((1 - t * t) / (1 + t * t), 2 * t / (1 + t * t)) if p["sampled"] else (0, t)
        left = r @ (p["A"] | p["C"]) + Matrix([[-s, -turn], [turn, -s]]) @ q
        free = left.square + (r @ (p["B"] | p["D"])).square == 0
        return free and bound > 0 and 0 < (r.square - q.square) * bound**2 <= (r @ (p["Bw"] | p["Dw"])).square

    def box(self, of, low, high, **claim):
        """Returns True if one X proves a claim at all corners of a box of factors: one per measurement, then one per input."""
        q, factors = len(self.p["Cy"].rows), product(*({*ends} for ends in zip(*(low | high).rows, strict=True)))
        loops = [ExactLoop(self.p, diagonal(f[q:]) @ self.K @ diagonal(f[:q])) for f in factors]
        kept = of in KINDS[:3] and len({loop.det > 0 for loop in loops}) == 1
        return kept and all(getattr(loop, of)(**claim) for loop in loops)

def check(text):
    """Returns the exit code, and a line of text about the certificate."""
    try:
        data, loops, results = json.loads(text), {}, []
        for name, p in data["plants"].items():
            size = {letter: len({one["name"] + "": one["unit"] + "" for one in p[key]}) for letter, key in SIGNALS.items()}
            plant, K = {key: read(p[key]) for key in SHAPES}, read(data["gain"])
            shapes = [(len(M.rows), len(M.T.rows)) for M in (*plant.values(), K)]  # pyright: ignore[reportAttributeAccessIssue]
            if shapes != [(size[a], size[b]) for a, b in (*SHAPES.values(), "uy")] or not min(size.values()):
                raise ValueError("a matrix does not fit the names of its signals")
            loops[name] = ExactLoop(plant | {"sampled": p["sample_period"] is not None}, K)
        for claim in data["claims"] or [{}]:  # a file without claims is rejected
            kind, loop, proof = claim.pop("kind"), loops[claim.pop("plant")], claim.pop("proof")
            if kind not in KINDS or (data["format"], proof) != ("LMI certificate 1", "exact"):
                raise ValueError("a claim has no exact proof, or is not of LMI certificate 1")
            arguments = {key: value if key == "of" else read(value) for key, value in claim.items()}
            results.append((f"{kind} {claim.get('bound', '')}".strip(), getattr(loop, kind)(**arguments)))
    except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
        return 2, f"NO CERTIFICATE, or no exact claim: {error!r:.80}"
    except ZeroDivisionError:
        results = [("a loop that has no solution", False)]
    false = [words for words, proved in results if not proved]
    return (1, f"NOT PROVED: {', '.join(false)}") if false else (0, f"PROVED: {', '.join(words for words, _ in results)}")

if __name__ == "__main__":
    code, line = check(Path(sys.argv[1]).read_text("utf-8"))
    sys.exit(print(line) or code)
