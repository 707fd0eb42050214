import math

import pytest

from greygate.contents import LARGEST
from greygate.errors import LONGEST, SHOWN, InputError, shown
from greygate.reading import DEEPEST, line, number, one_of, read_json, read_toml, table, truth, whole, within


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"a = [", "is not TOML"),
        (b"a = 1\na = 2", "is not TOML"),
        (b"a = \x00", "is not TOML"),
        (b"#" * (LARGEST + 1), "is larger than 67108864 bytes"),
        (b"a = \xff", "is not TOML"),
        (b"a = " + b"9" * 5000, "is not TOML"),
        (b"a = " + b"[" * 5000 + b"]" * 5000, "nested"),
        (b"a = " + b"[" * (DEEPEST + 1) + b"]" * (DEEPEST + 1), "nested"),
    ],
)
def test_a_toml_file_that_holds_no_plain_data_is_refused_in_a_line(tmp_path, text, says):
    path = tmp_path / "rig.toml"
    path.write_bytes(text)
    with pytest.raises(InputError, match=says) as refused:
        read_toml(path, "give a rig")
    assert str(refused.value).endswith("give a rig")


@pytest.mark.parametrize("text", [b"", b"{", b'{"a": 1, "a": 1}', b"[" * 100_000, b"9" * 5000, b"\xff\xfe{\x00}\x00"])
def test_a_json_file_that_holds_no_plain_data_is_refused_in_a_line(tmp_path, text):
    path = tmp_path / "program.json"
    path.write_bytes(text)
    with pytest.raises(InputError, match=r"program\.json: .*; compile again$"):
        read_json(path, "compile again")


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_json(tmp_path / "none.json", "make it")
    with pytest.raises(InputError, match="Is a directory"):
        read_toml(tmp_path, "give a file")


def test_nesting_up_to_the_limit_and_a_byte_order_mark_are_read(tmp_path):
    path = tmp_path / "deep.json"
    path.write_bytes(b"\xef\xbb\xbf" + b"[" * DEEPEST + b"]" * DEEPEST)
    assert read_json(path, "") is not None


def test_a_message_is_one_printable_line_of_bounded_length():
    message = str(InputError("rig.toml: name 'a\nb\x1b[31m\u202e\ud800' " + "x" * 10_000 + "; rename it"))
    assert message.isprintable()
    assert "a\\nb\\x1b[31m" in message
    assert len(message) <= LONGEST
    assert message.endswith("; rename it")


def test_whatever_a_value_is_a_message_shows_it_short():
    for value in (None, "x" * 1000, "\u202e\n", [["x" * 99] * 99] * 99, {"a": {"b": 10**400}}, 10**5000, [10**5000]):
        assert len(shown(value)) <= SHOWN
        assert shown(value).isprintable()


@pytest.mark.parametrize(
    ("kind", "takes", "refuses"),
    [
        (number, [0, -1.5, 1e308], [True, "1", None, math.nan, math.inf, 10**400, [1.0]]),
        (within(0.0, 1.0, "give 0 to 1"), [0, 1.0], [-1e-9, 1.1, math.nan, True, 10**400]),
        (whole(0, 5), [0, 5], [-1, 6, 1.0, True, "1"]),
        (truth, [True, False], [0, 1, "true", None]),
        (line, ["", "a b", "\u00b5m"], ["a\nb", "\u202e", "\ud800", 5, None]),
        (one_of(("input", "output")), ["input"], ["in", None, 5, ["input"]]),
    ],
)
def test_a_kind_takes_what_it_is_and_nothing_else(kind, takes, refuses):
    for value in takes:
        assert kind(value, "a.toml: x") == value
    for value in refuses:
        with pytest.raises(InputError, match=r"^a\.toml: x ") as refused:
            kind(value, "a.toml: x")
        assert "; " in str(refused.value)


def test_an_unknown_entry_is_told_with_the_one_that_may_be_meant():
    kinds = {"unit": line, "resolution": number}
    with pytest.raises(InputError, match=r"a\.toml: 'resolutoin': there is no such entry; write resolution if that"):
        table({"resolutoin": 1}, "a.toml:", {}, kinds)
    with pytest.raises(InputError, match=r"a\.toml: x\.'q': there is no such entry; known are unit, resolution"):
        table({"q": 1}, "a.toml: x", {}, kinds)
    assert table({"q": 1, "unit": "m"}, "a.toml:", {}, kinds, others=True) == {"unit": "m"}
    with pytest.raises(InputError, match="write resolution if that is meant"):
        table({"resolutoin": 1}, "a.toml:", {}, kinds, others=True)
    with pytest.raises(InputError, match=r"a\.toml: x\.unit is missing; add it"):
        table({}, "a.toml: x", {"unit": line}, others=True)
