"""`python -m sim.gallery`: numbers that others printed, beside what comes out here."""

import json
from collections.abc import Sequence

from models.common.command import Parser, run_command
from models.common.printed import Column, Stages, json_object, say, table, titled

EPILOG = """
Each row has the number that a source prints, ours by linear analysis, and the one
of a run in MuJoCo where a run shows it. A number is reproduced if ours rounds to
all its printed digits. Where it differs, the row says why.

exit code: 0 every number is reproduced or differs for a reason, 1 some does not,
2 bad input, 130 interrupted, 143 by SIGTERM, 129 by the end of its terminal

examples:
  python -m sim.gallery
  python -m sim.gallery mathworks --json
"""


def parser() -> Parser:
    """Returns the command-line parser."""
    parser = Parser("sim.gallery", "Compares numbers that others printed of suspensions with ours.", EPILOG)
    parser.add_argument("name", nargs="*", metavar="NAME", help="entry of the gallery (default: all)")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an entry is unknown.
    """
    options = parser().parse_args(arguments)
    from sim.studies.gallery.entries import names, read_entry
    from sim.studies.gallery.numbers import ComparedNumber, compared

    columns: list[Column[ComparedNumber]] = [
        Column("number", lambda one: one.printed.text, key="number"),
        Column("printed", lambda one: one.printed.shown),
        Column("exact", lambda one: one.exact, ".9g", key="exact"),
        Column("MuJoCo", lambda one: one.mujoco, ".7g", key="mujoco"),
        Column("verdict", lambda one: one.verdict.partition(":")[0], key="verdict"),
        Column("where", lambda one: one.printed.where, key="where"),
    ]
    entries = [read_entry(name) for name in dict.fromkeys(options.name or names())]
    stage, lines, objects, counts = Stages(*(entry.name for entry in entries)), list[str](), [], [0, 0, 0, 0]
    for entry in entries:
        stage(entry.name)
        numbers = compared(entry)
        objects.append(
            {
                "name": entry.name,
                "title": entry.title,
                "source": entry.source,
                "numbers": [
                    {
                        **json_object(columns, one),
                        "printed": one.printed.value,
                        "digits": one.printed.digits,
                        "unit": one.printed.unit,
                        "reason": one.printed.reason,
                    }
                    for one in numbers
                ],
                "missing": [vars(one) for one in entry.missing],
            }
        )
        lines += [*titled(f"{entry.name}: {entry.title}", entry.source)]
        if numbers:
            shown = [column for column in columns if column.title != "where"]
            rows = [[column.cell(one) for column in shown] for one in numbers]
            lines += table([[column.title for column in shown], *rows])
        reasons = dict.fromkeys(one.verdict for one in numbers if not one.reproduced)
        lines += [f"  {reason}" for reason in reasons]
        lines += [f"  not expressible: {one.what}: {one.why}" for one in entry.missing]
        lines.append("")
        counts[0] += sum(one.reproduced for one in numbers)
        counts[1] += sum(not one.reproduced and one.explained for one in numbers)
        counts[2] += sum(not one.reproduced and not one.explained for one in numbers)
        counts[3] += len(entry.missing)
    stage.end()
    if options.json:
        print(json.dumps({"entries": objects}, allow_nan=False))
    else:
        reproduced, differ, wrong, missing = counts
        last = f"{reproduced} numbers reproduced to all printed digits, {differ} differ for a reason, {wrong} NOT REPRODUCED"
        say([*lines, f"{last}; {missing} not expressible"])
    return 1 if counts[2] else 0


if __name__ == "__main__":
    run_command(main)
