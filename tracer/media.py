"""Refractive media: n as a function of the vacuum wavelength.

A refractive index is meaningless without its wavelength, so nothing here hands one out without being
given ``wavelength_nm``.  Glasses follow Sellmeier's equation

    n^2(lambda) = 1 + sum_i B_i lambda^2 / (lambda^2 - C_i),      lambda in um, C_i in um^2.

Sources of the coefficients (all at about 20 C):

* N-BK7, N-BK10, N-K5: Schott optical glass data sheets.
* fused-silica: Malitson, J. Opt. Soc. Am. 55, 1205 (1965).
* PMMA, polystyrene, polycarbonate: Sultanova, Kasarova, Nikolov, Acta Phys. Pol. A 116, 585 (2009), one term.
* borosilicate: of the 3.3 kind, one term through n_d = 1.4714 and n_F - n_C = 0.00714 (Schott, Borofloat 33);
  other makes differ by 0.003.
* soda-lime: Rubin, Sol. Energy Mater. 12, 275 (1985), clear, refitted by one term and one far in the infrared,
  within 2e-4 of his formula for 380-1100 nm; melts differ by 0.005.
* water: Daimon, Masumura, Appl. Opt. 46, 3811 (2007), at 20 C.
* air: Ciddor, Appl. Opt. 35, 1566 (1996), dry, 15 C, 101.325 kPa, 450 ppm CO2.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from tracer.errors import SceneError

LARGEST_INDEX = 10.0  # no solid or liquid comes near in the range below
THINNEST_LIQUID = 1.001  # below are gases, above liquids and solids
VISIBLE_NM = (300.0, 2000.0)  # where every formula below is used inside its measured range


@dataclass(frozen=True)
class ConstantMedium:
    """A medium whose index is given, for the wavelength in use, by one number."""

    index: float
    name: str = ""

    def n(self, wavelength_nm: float) -> float:
        """Return the given index, whatever the wavelength."""
        return self.index


@dataclass(frozen=True)
class SellmeierMedium:
    """A glass described by Sellmeier coefficients.

    Parameters
    ----------
    b : tuple of float
        B_i, dimensionless.
    c_um2 : tuple of float
        C_i [um^2], as many as B_i.
    name : str
        Name in messages and files.
    """

    b: tuple[float, ...]
    c_um2: tuple[float, ...]
    name: str = ""

    def n(self, wavelength_nm: float) -> float:
        """Refractive index at a vacuum wavelength [nm].

        Raises
        ------
        SceneError
            The wavelength lies at a resonance or outside 300-2000 nm.
        """
        check_wavelength(wavelength_nm)
        square_um2 = (wavelength_nm * 1e-3) ** 2
        resonant = square_um2 in self.c_um2
        terms = zip(self.b, self.c_um2, strict=True)
        epsilon = math.nan if resonant else 1.0 + sum(b * square_um2 / (square_um2 - c) for b, c in terms)
        if not 1.0 <= epsilon <= LARGEST_INDEX**2:
            raise SceneError(
                f"the coefficients of glass {self.name!r} give no n of 1-{LARGEST_INDEX:g} at {wavelength_nm:g} nm"
            )
        return math.sqrt(epsilon)


@dataclass(frozen=True)
class AirMedium:
    """Standard dry air after Ciddor (1996)."""

    name: str = "air"

    def n(self, wavelength_nm: float) -> float:
        """Refractive index at a vacuum wavelength [nm], about 1.00028 in green light."""
        check_wavelength(wavelength_nm)
        wavenumber2 = (1e3 / wavelength_nm) ** 2
        return 1.0 + 0.05792105 / (238.0185 - wavenumber2) + 0.00167917 / (57.362 - wavenumber2)


@dataclass(frozen=True)
class ShiftedMedium:
    """A glass whose index was measured: the dispersion of `base`, moved by a constant.

    Melts of one glass differ by some 1e-3 in n but hardly in dispersion, so an index fitted in one light
    holds in another:  n(lambda) = n_base(lambda) + offset.
    """

    base: SellmeierMedium | AirMedium
    offset: float
    name: str = ""

    def n(self, wavelength_nm: float) -> float:
        """Refractive index at a vacuum wavelength [nm]."""
        return self.base.n(wavelength_nm) + self.offset


Medium = ConstantMedium | SellmeierMedium | AirMedium | ShiftedMedium


def shifted(medium: Medium, change: float) -> Medium:
    """Return the medium with n changed by `change`, dispersion kept."""
    if change == 0.0:
        return medium
    if isinstance(medium, ConstantMedium):
        return ConstantMedium(medium.index + change, medium.name)
    if isinstance(medium, SellmeierMedium | AirMedium):
        return ShiftedMedium(medium, change, medium.name)
    return replace(medium, offset=medium.offset + change)


VACUUM = ConstantMedium(1.0, "vacuum")

MEDIA: dict[str, Medium] = {
    medium.name: medium
    for medium in (
        VACUUM,
        AirMedium(),
        SellmeierMedium((1.03961212, 0.231792344, 1.01046945), (0.00600069867, 0.0200179144, 103.560653), "N-BK7"),
        SellmeierMedium(
            (0.888308131, 0.328964475, 0.984610769), (0.00516900822, 0.0161190045, 99.7575331), "N-BK10"
        ),
        SellmeierMedium((1.08511833, 0.199562005, 0.930511663), (0.00661099503, 0.024110866, 111.982777), "N-K5"),
        SellmeierMedium(
            (0.6961663, 0.4079426, 0.8974794),
            (0.0684043**2, 0.1162414**2, 9.896161**2),
            "fused-silica",
        ),
        SellmeierMedium((1.1819,), (0.011313,), "PMMA"),
        SellmeierMedium((1.4435,), (0.020216,), "polystyrene"),
        SellmeierMedium((1.4182,), (0.021304,), "polycarbonate"),
        SellmeierMedium((1.1341834,), (0.00913713,), "borosilicate"),
        SellmeierMedium((1.29108346, 1535.45177), (0.00867355672, 141762.8), "soda-lime"),
        SellmeierMedium(
            (0.5684027565, 0.1726177391, 0.02086189578, 0.1130748688),
            (0.005101829712, 0.01821153936, 0.02620722293, 10.69792721),
            "water",
        ),
    )
}

MELTS = {  # standard deviation of n between melts, batches and makers
    "N-BK7": 5e-4, "N-BK10": 5e-4, "N-K5": 5e-4, "fused-silica": 1e-4, "PMMA": 1e-3, "polystyrene": 3e-3,
    "polycarbonate": 2e-3, "borosilicate": 3e-3, "soda-lime": 5e-3,
}  # fmt: skip
COMMON_NAMES = {  # what people call them, without case, spaces and hyphens
    "acrylic": "PMMA", "acrylicglass": "PMMA", "plexiglas": "PMMA", "plexiglass": "PMMA", "perspex": "PMMA",
    "bk7": "N-BK7", "nbk7": "N-BK7", "schottbk7": "N-BK7", "bk10": "N-BK10", "nbk10": "N-BK10", "k5": "N-K5",
    "nk5": "N-K5", "borosilicate33": "borosilicate", "borosilicateglass": "borosilicate",
    "borofloat": "borosilicate", "borofloat33": "borosilicate", "duran": "borosilicate", "pyrex": "borosilicate",
    "sodalime": "soda-lime", "sodalimeglass": "soda-lime", "windowglass": "soda-lime", "floatglass": "soda-lime",
    "fusedsilica": "fused-silica", "fusedquartz": "fused-silica", "quartz": "fused-silica",
    "quartzglass": "fused-silica", "silica": "fused-silica", "ps": "polystyrene", "pc": "polycarbonate",
    "makrolon": "polycarbonate", "lexan": "polycarbonate",
}  # fmt: skip


def medium_called(name: str, media: Mapping[str, Medium] = MEDIA) -> Medium | None:
    """Return the medium of this name, by its symbol or common name; None if it is unknown.

    Parameters
    ----------
    name : str
        Such as ``N-BK7``, ``BK7`` or ``acrylic``.
    media : mapping
        What is known by exact names, which win.
    """
    if name in media:
        return media[name]
    bare = re.sub(r"[\s_-]", "", name.casefold())
    plain = {re.sub(r"[\s_-]", "", known.casefold()): known for known in media}
    known = plain.get(bare) or COMMON_NAMES.get(bare, "")
    return media.get(known)


def media_names(media: Mapping[str, Medium] = MEDIA) -> str:
    """Names to choose from, for messages."""
    own = sorted(name for name in media if name not in MEDIA)
    return ", ".join([*own, "acrylic", "BK7", *sorted(name for name in MEDIA if name not in ("PMMA", "N-BK7"))])


def check_wavelength(wavelength_nm: float) -> None:
    """Refuse wavelengths outside the range in which the dispersion formulas hold.

    Raises
    ------
    SceneError
        Not within 300-2000 nm.
    """
    low, high = VISIBLE_NM
    if not low <= wavelength_nm <= high:
        raise SceneError(f"wavelength {wavelength_nm:g} nm is outside {low:g}-{high:g} nm; give it in nanometres")
