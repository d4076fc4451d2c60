"""Tables as any spreadsheet writes them: separators, decimal commas, byte order marks, quotes, blank lines."""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Collection
from typing import Final

_SEPARATORS: Final = (";", "\t", ",")
_DECIMAL_COMMA: Final = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?")


def parse_table(data: bytes, texts: Collection[str] = ()) -> tuple[list[str], list[tuple[int, list[str]]]]:
    """Return the columns' lower-case names, and each row with its line; decimal commas if no number has a point."""
    text = _decoded(data)
    first = next((line for line in text.splitlines() if line.strip()), "")
    if stated := re.fullmatch(r"\"?sep=(.)\"?\s*", first):  # Excel's own first line
        text, separator = text.replace(first, "", 1), stated[1]
    else:
        separator = max(_SEPARATORS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[tuple[int, list[str]]] = []
    try:
        rows.extend((reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row)))
    except csv.Error as error:
        raise ValueError(f"line {reader.line_num}: not CSV ({error})") from error
    header = [name.lower() for name in rows[0][1]] if rows else []
    while header and not header[-1]:
        header.pop()
    body = [(line, _without_blanks(row, len(header))) for line, row in rows[1:]]
    numbers = [index for index, name in enumerate(header) if name not in texts]
    if any("." in row[index] for _, row in body for index in numbers if index < len(row)):
        return header, body
    for _, row in body:
        for index in numbers:
            if index < len(row) and _DECIMAL_COMMA.fullmatch(row[index]):
                row[index] = row[index].replace(",", ".")
    return header, body


def _decoded(data: bytes) -> str:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("cp1252")  # what Excel calls CSV


def _without_blanks(row: list[str], width: int) -> list[str]:
    while len(row) > width and not row[-1]:
        row.pop()
    return row
