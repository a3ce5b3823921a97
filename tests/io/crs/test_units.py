"""Units of length by their names."""

from __future__ import annotations

import pytest
from pyproj import CRS
from pyproj.database import get_units_map

from tilepipe.io.crs.units import same_unit, unit_metres, unit_name

SURVEY_FOOT = 1200 / 3937


def test_every_length_of_epsg_is_known() -> None:
    for name, unit in get_units_map("EPSG", "linear").items():
        for spelling in (name, name.upper(), name.replace(" ", "_"), f" {name}. "):
            found = unit_metres(spelling)
            assert found is not None and same_unit(found, unit.conv_factor), spelling


@pytest.mark.parametrize(
    ("metres", "names"),
    [
        (1, "m|M|metre|Meter|METRES|m above sea level|metres above NAP|m a.s.l.|M A.S.L.|m Above NAP|1 m"),
        (0.1, "dm|DM|decimetre|decimeters|0.1 m|10 cm|10 CM"),
        (0.01, "cm|CM|centimeter|Centimetre|0.01 metres|1E-2 Metres|10 mm|10 MM"),
        (1000, "km|KM|kilometers|Kilometre"),
        (0.3048, "ft|FT|Ft|foot|Feet|feet|[ft_i]|foot_intl|international_feet|Foot (Intl)|ft."),
        (
            SURVEY_FOOT,
            "us-ft|ftUS|ft_us|[ft_us]|US ft|U.S. Survey Feet|Foot_US|US_survey_foot|survey_feet|usft|Feet_US",
        ),
        (0.9144, "yd|yard|[yd_i]|international_yards"),
        (0.0254, "in|In|IN|inch|inches|[in_i]"),
        (1609.344, "mi|mile|statute miles|[mi_i]"),
        (1852, "nmi|nautical_mile"),
        (0.3047972654, "Clarke's foot|Foot_Clarke"),
    ],
)
def test_spellings(metres: float, names: str) -> None:
    for name in names.split("|"):
        assert unit_metres(name) == pytest.approx(metres, rel=1e-15), name


@pytest.mark.parametrize(
    "name",
    [
        "",
        "1",
        "DN",
        "dBZ",
        "counts",
        "reflectance",
        "degree",
        "m2",
        "m^2",
        "m/s",
        "k/m",
        "sq ft",
        "us",
        "survey",
        "0 m",
        "Mm",
        "10 Mm",
        "Dm",
        "mM",
        "foot metre",
        "ft NAVD88",
        "second",
    ],
)
def test_what_is_no_length_is_not_known(name: str) -> None:
    assert unit_metres(name) is None


def test_an_axis_is_named_by_its_length_not_by_its_word() -> None:
    def axis(unit: str, metres: float):
        text = f'VERT_CS["heights",VERT_DATUM["sea",2005],UNIT["{unit}",{metres!r}],AXIS["Up",UP]]'
        return CRS.from_wkt(text).axis_info[0]

    assert unit_name(axis("foot", SURVEY_FOOT)) == "US survey foot"
    assert unit_name(axis("Foot_US", SURVEY_FOOT)) in ("Foot_US", "US survey foot")
    assert unit_metres(unit_name(axis("ell", 0.6858))) == pytest.approx(0.6858)


@pytest.mark.parametrize(
    ("prefix", "symbol", "factor"),
    # of the prefixes of the SI (BIPM 2019, table 7) those that occur with lengths on the ground
    [
        ("kilo", "k", 1e3),
        ("hecto", "h", 1e2),
        ("deca", "da", 1e1),
        ("", "", 1e0),
        ("deci", "d", 1e-1),
        ("centi", "c", 1e-2),
        ("milli", "m", 1e-3),
        ("micro", "µ", 1e-6),
    ],
)
def test_metres_with_prefixes(prefix: str, symbol: str, factor: float) -> None:
    for name in (f"{prefix}metre", f"{prefix}meters", f"{symbol}m"):
        assert unit_metres(name) == factor, name
