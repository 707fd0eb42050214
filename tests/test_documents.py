import pytest

from greygate.documents import DEEPEST, read_json, read_toml
from greygate.errors import LONGEST, InputError


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"a = [", "is no TOML"),
        (b"a = \xff", "is no TOML"),
        (b"a = " + b"9" * 5000, "is no TOML"),
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


@pytest.mark.parametrize("text", [b"", b"{", b"[" * 100_000, b"9" * 5000, b"\xff\xfe{\x00}\x00"])
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
