"""`python -m sim.new`: writes a commented vehicle file whose numbers the user can then replace."""

if __name__ == "__main__":
    from models.common.cli import run

    run("sim.new")

import json
from collections.abc import Sequence
from pathlib import Path

from models.common.command import Parser, print_json
from models.common.errors import InputError

TEMPLATES = Path(__file__).parents[1] / "models" / "templates"
TYPES = ("quarter_car", "half_car", "half_car_roll", "full_car")
EPILOG = """
The file contains the parameters of an ordinary car, limits, sensors with noise, a sample period and a delay, and controllers
designed for them. A comment on each line explains the value. The command never replaces an existing vehicle file.

With --schema the command also writes TYPE.schema.json to the same folder. Without FILE, it writes only this schema, to the
current folder. The first line of the vehicle file refers to the schema. Editors such as Visual Studio Code (extension Even
Better TOML) or Neovim (Taplo) then complete keys, show their meanings and units, and mark mistakes.

exit code: 0 the file is written; 2 invalid input

examples:
  roadproof new my_car.toml
  roadproof new my_full_car.toml --type full_car
  roadproof new my_half_car.toml --type half_car --schema
"""


def parser() -> Parser:
    """Returns the command-line parser of the command."""
    parser = Parser("sim.new", "Write a commented vehicle file that works with every command.", EPILOG)
    parser.add_argument("file", type=Path, nargs="?", metavar="FILE", help="file to write, such as my_car.toml")
    parser.add_argument("--type", choices=TYPES, default=TYPES[0], help=f"vehicle type (default: {TYPES[0]})")
    parser.add_argument("--schema", action="store_true", help="write a JSON schema that lets editors complete keys")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: an option is invalid, or the file already exists or cannot be written.
    """
    options = parser().parse_args(arguments)
    from models.common.files import read_text, whole_file
    from models.common.printed import pasted_path

    path: Path | None = options.file
    if path is None and not options.schema:
        raise InputError("FILE is missing; give the name of the file to write, as in roadproof new my_car.toml")
    written, schema = dict[str, str](), (path.parent if path else Path()) / f"{options.type}.schema.json"
    if path is not None:
        if path.exists():
            raise InputError(f"{path} already exists; give a different name, or remove this file")
        text = read_text(TEMPLATES / f"{options.type}.toml", "template", f"give one of {', '.join(TYPES)}")
        with whole_file(path, "vehicle file") as beside:
            beside.write_text(text, encoding="utf-8", newline="\n")
        written["file"] = str(path)
    if options.schema:
        from models.vehicle.file_schema import file_schema

        with whole_file(schema, "schema") as beside:
            beside.write_text(json.dumps(file_schema(options.type), indent=1) + "\n", encoding="utf-8", newline="\n")
        written["schema"] = str(schema)
    if options.json:
        print_json(written | {"type": options.type})
        return 0
    if options.schema:
        print(f"wrote {pasted_path(schema)}; a vehicle file refers to it in its first line: #:schema ./{schema.name}")
    if path is not None:
        name = pasted_path(path)
        print(f"wrote {name}; replace its numbers with those of your car, then run")
        print(f"  roadproof synth --vehicle {name}")
        print(f"  roadproof drive --vehicle {name} --class C --controller all")
    return 0
