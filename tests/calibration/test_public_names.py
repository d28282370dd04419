import pytest

import calibration


@pytest.mark.parametrize(
    "name",
    [
        "Board",
        "BoardRequest",
        "BoardSearch",
        "MeasuredNoise",
        "MeasuredResponse",
        "measure_noise",
        "measure_response",
        "Calibration",
        "View",
        "calibrate",
        "calibrate_views",
        "export_camera",
        "find_boards",
        "import_camera",
        "search_boards",
        "write_board",
        "write_calibration",
    ],
)
def test_public_names_load_when_asked_for(name):
    assert getattr(calibration, name).__name__ == name
    assert name in dir(calibration)


def test_another_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'undistort'"):
        calibration.undistort  # noqa: B018
