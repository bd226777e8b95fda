"""What a command that refuses says, and what it may leave."""


def assert_refused(said, *named):
    """Exit code 2 and one paragraph that names all of `named`."""
    assert said.code == 2
    assert said.out == ""
    *remarks, message = said.err.strip().split("\n")
    assert all(remark.endswith(("…", " s")) for remark in remarks), said.err  # progress before the failure
    assert message.startswith("slipmap: ")
    assert "Traceback" not in said.err
    for name in named:
        assert str(name) in message


def files_in(folder):
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
