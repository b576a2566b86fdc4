"""Measurement files of LabVIEW (.lvm) as tables of numbers.

Format: National Instruments, Specification for the LabVIEW Measurement File. The header of the file, and the header of each
segment, end with `***End_of_Header***`. The header of a segment has a column for each channel, and is followed by a line of
names and the lines of numbers. The entry `X_Columns` is "One" if the first column contains times, and "Multi" if each channel
has its own column of times. `X_Columns` is "No" if the times are given only by `X0` and `Delta_X`.
"""

from models.common.errors import InputError, short_repr

MAGIC, END = "LabVIEW Measurement", "***End_of_Header***"
TIME = "time [s]"


def lvm_text(text: str) -> str:
    """Returns the numbers of a LabVIEW file under headings with units, and the line number of each row in the file.

    Comments in rows are omitted.

    Raises:
        InputError: a header has no end, the file contains no times, or the channels of the file have different times.
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    ends = [i for i, line in enumerate(lines) if line.startswith(END)]
    if not ends:
        raise InputError(f"the LabVIEW file has no line {END}, so it seems to be incomplete; export the whole file")
    about = {words[0]: words[1] for line in lines[: ends[0]] if len(words := line.replace(",", "\t", 1).split("\t")) > 1}
    mark = {"comma": ",", "semicolon": ";"}.get(about.get("Separator", "").strip().lower(), "\t")
    if len(ends) == 1:  # the file has a header, but its only segment of data has no header
        return "\n".join(["", *[""] * ends[0], *lines[ends[0] + 1 :]])
    rows = [[cell.strip() for cell in line.split(mark)] for line in lines[ends[0] + 1 : ends[1]]]
    segment = {name: cells for name, *cells in rows}
    names = [name.strip() for name in lines[ends[1] + 1].split(mark)]
    while names and names[-1] in ("", "Comment"):
        names.pop()
    if dimension := next((one for one in segment.get("X_Dimension", ()) if one not in ("", "Time")), ""):
        raise InputError(
            f"X_Dimension is {short_repr(dimension)}, but only 'Time' is supported; export the channels as functions of time"
        )
    starts, steps = ([one for one in segment.get(key, ()) if one] for key in ("X0", "Delta_X"))
    columns = about.get("X_Columns", "One").strip().lower()
    if columns == "multi" and len({*starts}) * len({*steps}) != 1:
        raise InputError(
            "the channels have different X0 or Delta_X, so they have no common times; export all channels with the same "
            "times and a single X column"
        )
    if columns == "no" and not (starts and steps):
        raise InputError(
            "X_Columns is 'No', and X0 or Delta_X is missing, so the times of the samples are unknown; export the "
            "channels with one X column"
        )
    start, step = (float(one[0].replace(",", ".")) if columns == "no" else 0.0 for one in (starts, steps))
    kept = range(1, len(names), 2 if columns == "multi" else 1)
    units = [*segment.get("Y_Unit_Label", ()), *[""] * len(names)]
    headings = [TIME, *(f"{names[i]} [{units[i - 1]}]" if units[i - 1] else names[i] for i in kept)]
    table, row, skipped = [""] * (ends[1] + 1), 0, False
    table.append(mark.join(headings))
    for i, line in enumerate(lines[ends[1] + 2 :], ends[1] + 2):
        skipped = skipped or line.startswith("Channels")  # the header of another segment begins here
        cells = line.split(mark)
        if skipped or not line.strip() or cells[0].startswith("X_Value"):
            skipped = skipped and i not in ends
            table.append("")
            continue
        if columns == "no":
            cells = [repr(start + row * step), *cells[not cells[0].strip() :]]
        table.append(mark.join([cells[0], *(cells[k] for k in kept if k < len(cells))]))
        row += 1
    return "\n".join(table)
