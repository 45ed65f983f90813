import numpy as np
import pytest


def test_a_coverage_curve_is_printed_written_and_drawn(run, tmp_path):
    outcome = run(
        *("coverage", "sphere", "--sensors", "20", "--runs", "2"),
        *("--frames", "100", "--frames", "1600", "-o", "curve.csv", "--picture", "curve.png"),
    )
    assert outcome.code == 0, outcome.err
    rows = (tmp_path / "curve.csv").read_text().splitlines()
    assert rows[0].startswith("frames,seconds,sensors touched")
    assert [row.split(",")[0] for row in rows[1:]] == ["100", "1600"]
    touched = [float(row.split(",")[2].rstrip("%")) for row in rows[1:]]
    assert 0 < touched[0] <= touched[1] <= 100
    assert np.isfinite(float(rows[2].split(",")[4]))
    assert (tmp_path / "curve.png").read_bytes().startswith(b"\x89PNG")
    assert "neighbours touched together" in outcome.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["teapot"], "there is no body 'teapot'"),
        (["sphere", "-s", "rain"], "there is no scenario 'rain'"),
        (["sphere", "--frames", "0"], "frames"),
        (["sphere", "-m", "magic"], "there is no method 'magic'"),
        (["sphere", "--picture", "curve.bmp"], "must end in .png, .svg or .pdf"),
        (["sphere", "-p", "pace=1"], "has no parameter 'pace'"),
    ],
)
def test_invalid_arguments_are_refused_with_one_message(run, tmp_path, arguments, message):
    outcome = run("coverage", *arguments)
    assert outcome.code == 2
    assert message in " ".join(outcome.err.split())
    assert list(tmp_path.iterdir()) == []
