"""CSV files as programs and people write them: read rightly, or refused in a line that says what to do."""

import gzip
import json
import re
from itertools import product

import numpy as np
import pytest
from sweeping import every

from greygate.errors import InputError
from greygate.mismatch.rig import Channel, Rig
from greygate.plants.readers.read import read_recording
from greygate.plants.recording import read_csv
from greygate.plants.table import LARGEST

TIME, U, X = [0.0, 1.0, 2.0, 3.0], [1.5, -1.25, 0.0, 12.0], [0.01, 0.02, 1e-3, 4.0]
ROWS = [("0", "1.5", "0.01"), ("1", "-1.25", "0.02"), ("2", "0.0", "0.001"), ("3", "12", "4.0")]
HEADERS = {"port": "t_s,u_V,x_m", "rig": "t,u,x"}


@pytest.fixture(params=HEADERS)
def entrance(request, tmp_path):
    """Header of that form of CSV, and what reads bytes of it: channels, by `read_csv` or as a rig's recording."""

    def read(content: bytes):
        path = tmp_path / "run.csv"
        path.write_bytes(content)
        if request.param == "port":
            recording = read_csv(path, {"u": "V", "x": "m"})
        else:
            channels = {"u": Channel("V", "input"), "x": Channel("m", "output")}
            recording = Rig(None, {}, channels, ("x",), 1.0, None, tmp_path).recording(path)
        assert recording.dt == 1.0
        return recording

    return HEADERS[request.param], read


def text(header: str, rows, separator: str = ",", newline: str = "\n") -> str:
    return "".join(separator.join(row) + newline for row in (header.split(","), *rows))


def refused(read, content: bytes, phrase: str) -> None:
    with pytest.raises(InputError) as caught:
        read(content)
    message = str(caught.value)
    assert "run.csv: " in message
    assert "\n" not in message
    assert len(message) < 400
    assert phrase in message.partition("run.csv: ")[2]
    assert "; " in message, "says what to do"


# ---- dialects

QUOTED = [tuple(f'"{cell}"' for cell in row) for row in ROWS]
COMMAS = [tuple(cell.replace(".", ",") for cell in row) for row in ROWS]
DIALECTS = {
    "commas": (ROWS, ","),
    "quoted cells": (QUOTED, ","),
    "padded cells": ([tuple(f"  {cell} " for cell in row) for row in ROWS], ","),
    "cells padded by tabs": ([tuple(f"\t{cell}" for cell in row) for row in ROWS], ","),
    "semicolons": (ROWS, ";"),
    "tabs": (ROWS, "\t"),
    "decimal commas between semicolons": (COMMAS, ";"),
    "decimal commas between tabs": (COMMAS, "\t"),
    "quoted decimal commas": ([tuple(f'"{cell}"' for cell in row) for row in COMMAS], ","),
}
LINES = {
    "LF": lambda t: t,
    "CRLF": lambda t: t.replace("\n", "\r\n"),
    "CR": lambda t: t.replace("\n", "\r"),
    "no last newline": lambda t: t.rstrip("\n"),
    "blank last lines": lambda t: t + "\n\n",
    "blank first lines": lambda t: "\n\r\n" + t,
    "blank lines between": lambda t: t.replace("\n", "\n\n"),
    "lines of blanks": lambda t: t.replace("\n", "\n   \n"),
}
WRAPPINGS = {
    "plain": lambda t: t.encode(),
    "BOM": lambda t: t.encode("utf-8-sig"),
    "gzip": lambda t: gzip.compress(t.encode()),
    "gzip of BOM": lambda t: gzip.compress(t.encode("utf-8-sig")),
    "UTF-16": lambda t: t.encode("utf-16"),
    "UTF-16, high byte first": lambda t: b"\xfe\xff" + t.encode("utf-16-be"),
    "gzip of UTF-16": lambda t: gzip.compress(t.encode("utf-16")),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_gives_the_same_recording(entrance, dialect):
    header, read = entrance

    def check(lines, wrapping):
        recording = read(WRAPPINGS[wrapping](LINES[lines](text(header, *DIALECTS[dialect]))))
        np.testing.assert_array_equal(recording["u"], U)
        np.testing.assert_array_equal(recording["x"], X)
        np.testing.assert_array_equal(recording.time, TIME)

    every(product(LINES, WRAPPINGS), check)


ABOVE = {  # what programs write above and behind a table
    "sep line of Excel": lambda t: "sep=;\n" + t.replace(",", ";"),
    "sep line in quotes": lambda t: '"sep=,"\n' + t,
    "a comment": lambda t: "# a rig\n" + t,
    "a comment with commas": lambda t: "# a rig, measured\n" + t,
    "names in a comment": lambda t: "# " + t,
    "names in the last of some comments": lambda t: "% a rig\n%\n%" + t,
    "pairs": lambda t: "Model,TDS2024\nSerial,12345\nDate,2026-11-30 10:00\n\n" + t,
    "a title of words": lambda t: "Measured on the rig in the cellar\n\n" + t,
    "rows of another count of numbers": lambda t: "Segments,1,Size,200\n#1,30-Nov-2026,0,0\n" + t,
    "pairs above semicolons": lambda t: "Rig;7\n" + t.replace(",", ";"),
    "many lines": lambda t: "note\n" * 150 + t,
    "separators at the end": lambda t: t.replace("\n", ",\n"),
    "separators at the end of rows": lambda t: t.replace("\n", ",\n").replace(",\n", "\n", 1),
    "blanks": lambda t: t.replace(",", " "),
    "columns in line by blanks": lambda t: t.replace(",", "   ").replace("\n", "\n  "),
}


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_what_stands_above_a_table_is_left_out(entrance, newline):
    header, read = entrance

    def check(above):
        recording = read(ABOVE[above](text(header, ROWS)).replace("\n", newline).encode())
        np.testing.assert_array_equal(recording["u"], U)
        np.testing.assert_array_equal(recording["x"], X)
        np.testing.assert_array_equal(recording.time, TIME)

    every(ABOVE, check)


NO_NAMES = {  # what does not tell where the names are, or would lose a sample
    "a first sample of nan": ("t,u [V]\nnan,nan\n1,2\n2,3\n", "row 2, column t: 'nan'"),
    "a first sample with a word": ("t,u [V]\n0,lost\n1,2\n2,3\n", "row 2, column u [V]: 'lost'"),
    "words between names and numbers": (
        "t,u [V]\nthe recorder starts,not yet armed here\n1,2\n2,3\n",
        "column 'u [V]' names two units, V and 'not yet armed here'",
    ),
    "no names at all": ("# by a logger\n0,1\n1,2\n2,3\n", "column"),
    "numbers in the first row": ("0,1\n1,2\n2,3\n", "the first row has numbers; write the names above"),
    "a short row": ("# by a logger\nt,u [V]\n0,1\n1\n2,3\n", "row 4 has 1 cells, the header 2"),
    "a word further down": ("# by a logger\nt,u [V]\n0,1\n1,lost\n2,3\n", "row 4, column u [V]: 'lost'"),
}


@pytest.mark.parametrize("name", NO_NAMES)
def test_where_the_names_are_not_plain_a_file_is_refused_by_its_own_rows(name, tmp_path):
    content, phrase = NO_NAMES[name]
    (tmp_path / "run.csv").write_text(content)
    with pytest.raises(InputError, match=re.escape(phrase)):
        read_recording(tmp_path / "run.csv")


def test_what_is_left_out_and_when_a_recording_began_is_said(tmp_path, greygate):
    (tmp_path / "a.csv").write_text(
        "Rig,7\ntime,u [V]\n2026-10-25T23:59:59.5Z,1\n2026-10-26T00:00:00Z,2\n2026-10-26T00:00:00.5Z,3\n"
    )
    code, out, error = greygate("look", tmp_path / "a.csv", "--json")
    assert code == 0
    assert json.loads(out)["channels"][0]["step_s"] == 0.5
    assert "the lines above line 2" in error
    assert "time counts seconds from 2026-10-25T23:59:59.5Z" in error


TIMES = {
    "2026-11-30 08:15:00.250,2026-11-30 08:15:00.500,2026-11-30 08:15:00.750": 0.25,
    "2026-11-30T08:15,2026-11-30T08:16,2026-11-30T08:17": 60.0,
    "8:59:59.9,9:00:00.0,9:00:00.1": 0.1,
    "2026-11-30T08:15:00+01:00,2026-11-30T08:15:01+01:00,2026-11-30T08:15:02+01:00": 1.0,
    "23:59:59,00:00:00,00:00:01": "does not increase",
    "2026-11-30T08:15:00Z,2026-11-30T08:15:01+01:00,2026-11-30T08:15:02Z": "times of the zones",
    "08:15:00,2026-11-30 08:15:01,2026-11-30 08:15:02": "some times have a date and some have none",
    "2026-13-30T08:15:00,2026-13-30T08:15:01,2026-13-30T08:15:02": "is no time",
    "2026-11-30T08:15:00,12,2026-11-30T08:15:02": "'12' is no time as '2026-11-30T08:15:00' is",
    "30.11.2026 08:15:00,30.11.2026 08:15:01,30.11.2026 08:15:02": "is not a finite number",
}


@pytest.mark.parametrize("times", TIMES)
def test_dates_and_times_of_day_count_seconds(times, tmp_path):
    rows = "".join(f"{t},{k}\n" for k, t in enumerate(times.split(",")))
    (tmp_path / "run.csv").write_text("time,u [V]\n" + rows)
    if isinstance(step := TIMES[times], float):
        assert read_recording(tmp_path / "run.csv").dt == step
        (tmp_path / "run.csv").write_text("time [ms],u [V]\n" + rows)
        step = "column time [ms]"
    with pytest.raises(InputError, match=re.escape(step)):
        read_recording(tmp_path / "run.csv")


# ---- cells

NUMBERS = {
    "1": 1.0, "+1": 1.0, "-1": -1.0, "1.": 1.0, ".5": 0.5, "-.5": -0.5, "007": 7.0, "-0": 0.0, "1e3": 1e3,
    "1E3": 1e3, "1e+3": 1e3, "1.25e-3": 1.25e-3, ".5e1": 5.0, "1.e2": 100.0, "0.1": 0.1, "1e-400": 0.0,
    "4.9e-324": 5e-324, "9007199254740993": 9007199254740992.0, "0.30000000000000004": 0.30000000000000004,
    "1e30": 1e30, "-1e30": -1e30, "0" * 400 + "1": 1.0, "1." + "0" * 5000: 1.0, '"1.5"': 1.5, " 1.5\t": 1.5,
}  # fmt: skip


def test_a_number_is_read_to_the_last_bit(entrance):
    header, read = entrance

    def check(cell, number):
        recording = read(text(header, [*ROWS[:2], ("2", cell, "0"), ROWS[3]]).encode())
        assert recording["u"][2] == number

    every(NUMBERS.items(), check)


WORDS = "write plain digits"
CELLS = {
    "1_000": WORDS, "1_0": WORDS, "١٢": WORDS, "१२": WORDS, "１": WORDS, "²": WORDS, "½": WORDS,
    "\u00a01": WORDS, "1\u00a0": WORDS, "1\u00a0000": WORDS, "1\u2009000": WORDS, "1\u202f000": WORDS, "1 000": WORDS,
    "1'000": WORDS, "1\u2019000": WORDS, "\u22121": WORDS, "\u20131": WORDS, "0x1F": WORDS, "0b1": WORDS, "0o7": WORDS,
    "1e": WORDS, "e5": WORDS, "1e5.0": WORDS, "1d5": WORDS, "1.2.3": WORDS, "1.234.567": WORDS, "--1": WORDS,
    "1-2": WORDS, "1+": WORDS, ".": WORDS, "-": WORDS, "+": WORDS, "1/2": WORDS, "50%": WORDS, "1.5V": WORDS,
    "1.5 V": WORDS, "lots": WORDS, "True": WORDS, "None": WORDS, "null": WORDS, "NA": WORDS, "N/A": WORDS,
    "#DIV/0!": WORDS, "#N/A": WORDS, "1.#INF": WORDS, "1.#QNAN": WORDS, "=1+1": WORDS, "$1": WORDS, "1j": WORDS,
    "(1)": WORDS, "2026-11-22": WORDS, "12:00:01": WORDS, "1:5": WORDS, "1|5": WORDS, "\ufeff1": WORDS,
    "1\x1b[31m": WORDS, "1\x0b": WORDS, "1\x85": WORDS, "1\u2028": WORDS, "x" * 3000: WORDS,
    "'1'": WORDS, '"1 ""2"""': WORDS,
    '"1\n2"': WORDS, "nan": "repair or cut", "NaN": "repair or cut", "-nan": "repair or cut", "inf": "repair or cut",
    "-inf": "repair or cut", "Infinity": "repair or cut", "": "is an empty cell; fill it", " ": "is an empty cell",
    '""': "is an empty cell", "\t": "is an empty cell", "1e400": "beyond any quantity",
    "-1e400": "beyond any quantity",
    "1e308": "beyond any quantity", "1.1e30": "beyond any quantity",
    "9" * 400: "beyond any quantity", '"1,234,567"': "no separators of thousands",
    '"1,234.5"': "no separators of thousands", '"1.234,5"': "no separators of thousands",
    '"1,5"': "write decimal points",
    '"1,500"': "write decimal points", "1;5": "separate every row as the",
    "1\t5": "separate every row as the",
}  # fmt: skip


@pytest.mark.parametrize("wrapping", ["plain", "gzip"])
def test_a_cell_that_is_no_number_is_refused_with_its_row_and_column(entrance, wrapping):
    header, read = entrance

    def check(cell, phrase):
        content = WRAPPINGS[wrapping](text(header, [*ROWS[:2], ("2", cell, "0.001"), ROWS[3]]))
        row = 4 + cell.count("\n")
        refused(read, content, f"row {row}, column {header.split(',')[1]}: ")
        refused(read, content, phrase)

    every(CELLS.items(), check)


def test_a_comma_that_may_separate_thousands_is_not_taken_for_a_decimal_one(entrance):
    header, read = entrance
    rows = [(str(t), f"{t + 1},500", "0") for t in range(4)]
    refused(read, text(header, rows, ";").encode(), "row 2, column u")
    rows[3] = ("3", "4,50", "0")
    assert read(text(header, rows, ";").encode())["u"].tolist() == [1.5, 2.5, 3.5, 4.5]
    rows[2] = ("2", "3.5", "0")
    refused(read, text(header, rows, ";").encode(), "write decimal points")


# ---- files

H = "HEADER\n"
BODY = "".join(",".join(row) + "\n" for row in ROWS)
FILES = {
    "empty": ("", "the file is empty; give a header row"),
    "blank lines alone": ("\n\n\r\n", "the file is empty"),
    "blanks alone": ("  \n \n", "the file is empty"),
    "BOM alone": ("\ufeff", "the file is empty"),
    "header alone": (H, "holds 0 samples", "0 samples, 0 s; record at least"),
    "one sample": (H + "0,1,2\n", "holds 1 samples; give at least 2", "1 samples, 1 s; record at least"),
    "one column": ("TIME\n0\n1\n2\n", "the header has one column"),
    "separated by bars": ("TIME|COLU|COLX\n" + BODY.replace(",", "|"), "the header has one column"),
    "no header": (BODY, "column"),
    "units below the header": (H + "s,V,m\n" + BODY, "keep one header with the units in its names, and delete this"),
    "a second header": (H + BODY + H, "keep one header"),
    "a closing line of text": (H + BODY + "end,,\n", "keep one header"),
    "a row of empty cells": (H + BODY + ",,\n", "is an empty cell"),
    "two separators in the header": ("TIME;COLU,COLX\n" + BODY, "commas and semicolons separate the header"),
    "rows separated otherwise": (H + BODY.replace(",", ";"), "has 1 cells, the header 3"),
    "decimal commas between commas": (H + "0,0,1,5,0,01\n1,0,1,4,0,02\n", "semicolons if commas are decimal"),
    "one decimal comma between commas": (H + "0,1,5,2\n1,1,5,2\n", "row 2 has 4 cells, the header 3"),
    "row too short": (H + BODY + "4,1\n", "row 6 has 2 cells, the header 3; correct the row"),
    "row too long": (H + BODY + "4,1,2,3\n", "row 6 has 4 cells, the header 3"),
    "row too short after blank lines": (H + "\n\n" + BODY + "4,1\n", "row 8 has 2 cells"),
    "row cut short": (H + BODY + "4", "row 6 has 1 cells"),
    "nameless column": ("TIME,,COLX\n" + BODY, "column 2 has no name; name it"),
    "nameless first column": (",COLU,COLX\n" + BODY, "column 1 has no name"),
    "column twice": ("TIME,COLU,COLU\n" + BODY, "appears twice; rename or delete one"),
    "time twice": ("TIME,COLU,COLX,TIME\n" + BODY.replace("\n", ",1\n"), "appears twice"),
    "column absent": ("TIME,COLU\n0,1\n1,2\n2,3\n", "column x"),
    "column of another name": ("TIME,COLU,y_m\n" + BODY, "column"),
    "time absent": ("COLU,COLX\n1,2\n2,3\n3,4\n", "first column"),
    "time last": ("COLU,COLX,TIME\n" + BODY, "first column"),
    "time called otherwise": ("seconds,COLU,COLX\n" + BODY, "the first column is 'seconds'", "first column 'seconds'"),
    "time in capitals": ("T,COLU,COLX\n" + BODY, "first column"),
    "header with a newline": ('TIME,"u\n`evil`_V",COLX\n' + BODY, "column 2, 'u"),
    "header with a carriage return": ('TIME,"u\r_V",COLX\n' + BODY, "does not print; rename it"),
    "header with an escape": ("TIME,u\x1b[31m_V,COLX\n" + BODY, "does not print; rename it"),
    "header with a line separator": ("TIME,u\u2028_V,COLX\n" + BODY, "does not print; rename it"),
    "header that turns round": ("TIME,u\u202e_V,COLX\n" + BODY, "does not print; rename it"),
    "header of zero width": ("TIME,\u200b,COLX\n" + BODY, "does not print; rename it"),
    "header with a tab": ("TIME,u\t2_V,COLX\n" + BODY, "does not print; rename it"),
    "time stands": (H + "0,1,2\n1,1,2\n1,1,2\n2,1,2\n", "row 4, column TIME does not increase (from 1 to 1); sort"),
    "time stands all along": (H + "1,1,2\n1,1,2\n1,1,2\n", "row 3, column TIME does not increase"),
    "time goes back": (H + "0,1,2\n1,1,2\n2,1,2\n1.5,1,2\n", "row 5, column TIME does not increase (from 2 to 1.5)"),
    "time runs backwards": (H + "3,1,2\n2,1,2\n1,1,2\n0,1,2\n", "row 3, column TIME does not increase"),
    "two recordings in one": (H + BODY + BODY, "row 6, column TIME does not increase"),
    "a sample is missing": (
        H + "0,1,2\n1,1,2\n3,1,2\n4,1,2\n5,1,2\n",
        "row 4, column TIME: step 2 s where 1 s ",
    ),
    "many are missing": (H + BODY + "1000,1,2\n", "row 6, column TIME: step 997 s where 1 s "),
    "jitter": (H + "0,1,2\n1.01,1,2\n2,1,2\n3,1,2\n", "step 1.01 s where 1 s "),
    "a step too many": (H + "0,1,2\n1,1,2\n1.5,1,2\n2,1,2\n3,1,2\n4,1,2\n", "step 0.5 s where 1 s "),
    "time is huge": (H + "1e308,1,2\n-1e308,1,2\n1e308,1,2\n", "row 2, column TIME: '1e308' is beyond any quantity"),
    "everything is huge": (H + "1e308,1e308,1e308\n" * 4, "is beyond any quantity; give numbers up to 1e+30"),
    "everything is a clock": (H + "12:00,1,2\n12:01,1,2\n12:02,1,2\n", "row 2, column TIME: '12:00' is not"),
    "quote left open": (H + BODY + '4,"1,2\n', "unexpected end of data"),
    "text after a quote": (H + BODY + '4,"1"5,2\n', "expected after"),
    "a cell beyond the reader": (H + BODY + "4," + "1" * 200_000 + ",2\n", "field larger than field limit"),
    "ten thousand columns": (H + ",".join("1" * 10_000) + "\n", "row 2 has 10000 cells, the header 3"),
}


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_a_file_that_cannot_serve_is_refused_with_what_to_do(entrance, newline):
    header, read = entrance
    words = dict(zip(("TIME", "COLU", "COLX"), header.split(","), strict=True)) | {"HEADER": header}

    def check(case):
        content, *phrases = FILES[case]
        phrase = phrases[0] if header == HEADERS["port"] else phrases[-1]
        for word, name in words.items():
            content, phrase = content.replace(word, name), phrase.replace(word, name)
        refused(read, content.replace("\n", newline).encode(), phrase)

    every(FILES, check)


WHOLE = "HEADER\n" + BODY
BYTES = {
    "UTF-16 without a mark": (lambda t: t.encode("utf-16-le"), "(byte 1 is 0); save it as UTF-8"),
    "UTF-16 cut in a letter": (lambda t: t.encode("utf-16")[:-1], "is not a CSV text file in UTF-16; save it as"),
    "UTF-32": (lambda t: t.encode("utf-32"), "save it as UTF-8 CSV"),
    "Mac Roman": (lambda t: (t + "4,1,\u00b0\n").encode("mac-roman"), "is not a CSV text file in UTF-8 (row 6); save"),
    "DOS": (lambda t: (t + "4,1,\u00fc\n").encode("cp850"), "is not a CSV text file in UTF-8 (row 6); save it"),
    "bytes of nothing": (lambda t: bytes(range(128, 256)), "is not a CSV text file"),
    "a byte 0 at the end": (lambda t: t.encode() + b"\0", "is not a CSV text file (byte"),
    "a PNG": (lambda t: b"\x89PNG\r\n\x1a\n" + t.encode(), "is not a CSV text file"),
    "a zip archive": (
        lambda t: b"PK\x03\x04\x14\x00" + t.encode(),
        "is a zip archive, as a spreadsheet of Excel is; save",
    ),
    "end of file of DOS": (lambda t: t.encode() + b"\x1a", "row 6 has 1 cells"),
    "gzip cut short": (lambda t: gzip.compress(t.encode())[:-12], "is not a complete gzip file"),
    "gzip with a wrong sum": (lambda t: gzip.compress(t.encode())[:-8] + b"\0" * 8, "is not a complete gzip file"),
    "gzip with a wrong body": (lambda t: gzip.compress(t.encode())[:10] + b"\xff" * 30, "is not a complete gzip file"),
    "gzip of nothing": (lambda t: gzip.compress(b""), "the file is empty"),
    "gzip of gzip": (lambda t: gzip.compress(gzip.compress(t.encode())), "is not a CSV text file"),
}


@pytest.mark.parametrize("title", ["Öldruck für Kolben", "pression à l'entrée, côté tête"])
def test_a_spreadsheet_of_windows_in_german_or_french_is_read_and_that_is_said(title, tmp_path, greygate):
    text = f'Zeit [s];"{title} [µm]"\n0,0;1,5\n0,1;2,5\n0,2;1,5\n'
    (tmp_path / "utf8.csv").write_bytes(text.encode())
    (tmp_path / "a.csv").write_bytes(text.encode("cp1252"))
    (code, out, error), (_, same, silent) = (greygate("look", tmp_path / n, "--json") for n in ("a.csv", "utf8.csv"))
    assert (code, json.loads(out)["channels"], silent) == (0, json.loads(same)["channels"], "")
    assert "read as Windows-1252" in error


def test_a_file_that_is_no_text_is_refused_with_what_to_do(entrance):
    header, read = entrance

    def check(case):
        make, phrase = BYTES[case]
        refused(read, make(WHOLE.replace("HEADER", header)), phrase)

    every(BYTES, check)


def test_an_archive_that_unpacks_without_end_is_not_unpacked(entrance, monkeypatch):
    header, read = entrance
    monkeypatch.setattr("greygate.plants.table.MOST_UNPACKED", 1000)
    refused(read, gzip.compress((header + "\n" + BODY * 1000).encode()), "unpacks to more than 1000 bytes")


@pytest.mark.parametrize(("name", "phrase"), [(".", "Is a directory"), ("none.csv", "No such file"), ("a\0b", "null")])
def test_what_is_no_file_is_refused(tmp_path, name, phrase):
    with pytest.raises(InputError, match=f"cannot be read .*{phrase}.*; check the path"):
        read_csv(tmp_path / name)


def test_correlations_of_squares_of_the_largest_number_stay_finite():
    assert np.isfinite(np.float64(LARGEST) ** 8 * 2.0**64)


def test_at_least_150_variants_are_tried():
    variants = len(DIALECTS) * len(LINES) * len(WRAPPINGS) + len(NUMBERS) + len(CELLS) + len(FILES) + len(BYTES)
    assert variants >= 150
