"""Of GDAL's side file only counts what decides values or places, not what viewers add."""

from __future__ import annotations

import pytest

from tilepipe.io.files.identity import EMPTY, MISSING, file_state

STATISTICS = '<Metadata><MDI key="STATISTICS_MEAN">3</MDI><MDI key="STATISTICS_MAXIMUM">9</MDI></Metadata>'
HISTOGRAMS = "<Histograms><HistItem><HistMin>0</HistMin></HistItem></Histograms>"


def state(path, content: str):
    path.write_text(content)
    return file_state(str(path))


def band(*content: str) -> str:
    return f'<PAMDataset>\n  <PAMRasterBand band="1">\n{"".join(content)}</PAMRasterBand>\n</PAMDataset>\n'


@pytest.mark.parametrize(
    "content",
    [
        "<PAMDataset></PAMDataset>",
        "<PAMDataset>\n</PAMDataset>",
        f"<PAMDataset>{STATISTICS}</PAMDataset>",
        "<PAMDataset><Metadata /></PAMDataset>",
        band(STATISTICS),
        band(HISTOGRAMS),
        band(STATISTICS, HISTOGRAMS),
        "<PAMDataset",
    ],
)
def test_what_viewers_add_is_nothing(tmp_path, content):
    assert state(tmp_path / "a.tif.aux.xml", content) == EMPTY
    assert EMPTY.is_nothing


@pytest.mark.parametrize(
    "more",
    [
        "<ColorInterp>Gray</ColorInterp>",
        "<Description />",
        "<Metadata><MDI key='OFFSET'>3</MDI></Metadata>",
        "<NoDataValue>3</NoDataValue>",
        "<UnitType>ft</UnitType>",
    ],
)
def test_all_else_counts(tmp_path, more):
    path = tmp_path / "a.tif.aux.xml"
    found = state(path, band(more))
    assert not found.is_nothing
    assert found == state(path, band(STATISTICS, more)) == state(path, band(more, "\n", HISTOGRAMS, "\n"))
    assert found != state(path, band(more, "<Scale>2</Scale>"))


def test_there_may_be_none(tmp_path):
    assert file_state(str(tmp_path / "a.tif.aux.xml")) == EMPTY
    assert file_state(str(tmp_path / "a.tif")) == MISSING and MISSING.is_nothing
