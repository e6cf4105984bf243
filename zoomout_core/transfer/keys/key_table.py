# SPDX-License-Identifier: GPL-3.0-or-later
"""The names of expression keys in each convention, as one table.

Each row is one expression. A cell contains the name of its key, without the prefix of the convention. In a cell

- `*` is a side: the row is two expressions, left and right;
- `{A,B}` is the sum of the keys with A and with B, and `&` that of both sides;
- `/` separates alternative keys, or sums of keys, for the same expression. The first is written, the others are only
  read; a cell that begins with `/` is only read.

A cell is empty if the convention has no such expression, or only one that also moves other parts of the face. Visemes
and emotions are therefore not composed of ARKit's keys.

Sources: Apple's `ARFaceAnchor.BlendShapeLocation`; VRCFaceTracking's Unified Expressions, with their comparison to
ARKit; the controls of MetaHuman's rig as Unreal Engine names them, beside those keys of ARKit that move its face alike;
MakeHuman's folder `targets/expression/units`; Oculus Lipsync's viseme reference, as Ready Player Me and VRChat spell
it; the schemas of VRM 0.x and 1.0. Left and right are those of the character.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import product
from typing import NamedTuple, TypeAlias


class Spelling(NamedTuple):
    """How a convention writes its names.

    Attributes:
        title: the convention's name for the user.
        prefix: the text before each name.
        left: the text that replaces `*` for the left side.
        right: the same for the right side.
    """

    title: str
    prefix: str = ""
    left: str = "Left"
    right: str = "Right"


CONVENTIONS = {
    "arkit": Spelling("ARKit"),
    "unified": Spelling("Unified Expressions"),
    "metahuman": Spelling("MetaHuman", "CTRL_expressions_", "L", "R"),
    "makehuman": Spelling("MakeHuman", "", "left", "right"),
    "oculus": Spelling("Oculus", "viseme_"),
    "vrchat": Spelling("VRChat", "vrc.v_"),
    "vrm0": Spelling("VRM 0", "", "_l", "_r"),
    "vrm1": Spelling("VRM 1"),
}

# The first line of each block names the conventions of its columns.
TABLE = """
arkit                      | unified                                | metahuman               | makehuman
eyeBlink*                  | EyeClosed*                             | eyeBlink*               | eye-*-closure
eyeSquint*                 | EyeSquint*                             | eyeSquintInner*         | eye-*-slit
eyeWide*                   | EyeWide*                               | eyeWiden*               | eye-*-opened-up
eyeLookUp*                 | EyeLookUp*                             | eyeLookUp*              |
eyeLookDown*               | EyeLookDown*                           | eyeLookDown*            |
eyeLookInLeft              | EyeLookInLeft                          | eyeLookRightL           |
eyeLookInRight             | EyeLookInRight                         | eyeLookLeftR            |
eyeLookOutLeft             | EyeLookOutLeft                         | eyeLookLeftL            |
eyeLookOutRight            | EyeLookOutRight                        | eyeLookRightR           |
                           | EyeDilation*                           | eyePupilWide*           |
                           | EyeConstrict*                          | eyePupilNarrow*         |
browDown*                  | BrowDown* / Brow{Lowerer,Pinch}*       | browDown*               | eyebrows-*-down
                           | BrowLowerer*                           |                         |
                           | BrowPinch*                             |                         |
browInnerUp / browInnerUp& | BrowInnerUp / BrowInnerUp&             | browRaiseIn&            | eyebrows-&-inner-up
/ browInnerUp*             | BrowInnerUp*                           | browRaiseIn*            | eyebrows-*-inner-up
browOuterUp*               | BrowOuterUp*                           | browRaiseOuter*         | eyebrows-*-extern-up
                           | BrowUp* / Brow{Inner,Outer}Up*         | browRaise{In,Outer}*    | eyebrows-*-up
noseSneer*                 | NoseSneer*                             | noseWrinkle*            |
                           | NasalDilation*                         | noseNostrilDilate*      | nose-*-dilatation
                           | NasalConstrict*                        | noseNostrilCompress*    |
cheekPuff / cheekPuff&     | CheekPuff / CheekPuff&                 | mouthCheekBlow&         |
/ cheekPuff*               | CheekPuff*                             | mouthCheekBlow*         |
                           | CheekSuck*                             | mouthCheekSuck*         |
cheekSquint*               | CheekSquint*                           | eyeCheekRaise*          |
jawOpen                    | JawOpen                                | jawOpen                 | mouth-open
jawForward                 | JawForward                             | jawFwd                  |
                           | JawBackward                            | jawBack                 |
jawLeft                    | JawLeft                                | jawLeft                 |
jawRight                   | JawRight                               | jawRight                |
                           | JawClench                              | jawClench&              |
                           | JawMandibleRaise                       |                         |
mouthClose                 | MouthClosed                            | mouthLipsTogether{U,D}& |
mouthFunnel                | LipFunnel / LipFunnel{Upper,Lower}&    | mouthFunnel{U,D}&       |
                           | LipFunnelUpper*                        | mouthFunnelU*           |
                           | LipFunnelLower*                        | mouthFunnelD*           |
mouthPucker                | LipPucker / LipPucker{Upper,Lower}&    | mouthLipsPurse{U,D}&    | mouth-pursing
                           | LipPuckerUpper*                        | mouthLipsPurseU*        |
                           | LipPuckerLower*                        | mouthLipsPurseD*        |
mouthRollUpper             | LipSuckUpper / LipSuckUpper&           | mouthUpperLipRollIn&    |
                           | LipSuckUpper*                          | mouthUpperLipRollIn*    |
mouthRollLower             | LipSuckLower / LipSuckLower&           | mouthLowerLipRollIn&    |
                           | LipSuckLower*                          | mouthLowerLipRollIn*    |
                           | LipSuckCorner*                         |                         |
mouthLeft                  | MouthLeft / Mouth{Upper,Lower}Left     | mouthLeft               |
mouthRight                 | MouthRight / Mouth{Upper,Lower}Right   | mouthRight              |
                           | MouthUpperLeft                         | mouthUpperLipShiftLeft  |
                           | MouthUpperRight                        | mouthUpperLipShiftRight |
                           | MouthLowerLeft                         | mouthLowerLipShiftLeft  |
                           | MouthLowerRight                        | mouthLowerLipShiftRight |
mouthSmile*                | MouthSmile* / MouthCorner{Pull,Slant}* | mouthCornerPull*        |
                           | MouthCornerPull*                       |                         |
                           | MouthCornerSlant*                      | mouthSharpCornerPull*   |
mouthSmile&                | MouthSmile& / MouthSmile               | mouthCornerPull&        | mouth-corner-puller
mouthFrown*                | MouthFrown*                            | mouthCornerDepress*     |
mouthFrown&                | MouthFrown&                            | mouthCornerDepress&     | mouth-depression
mouthDimple*               | MouthDimple*                           | mouthDimple*            |
mouthStretch*              | MouthStretch*                          | mouthStretch*           |
mouthPress*                | MouthPress*                            |                         |
                           | MouthTightener*                        | mouthLipsTighten{U,D}*  |
mouthShrugUpper            | MouthRaiserUpper                       |                         |
mouthShrugLower            | MouthRaiserLower                       | jawChinRaiseD&          |
mouthUpperUp*              | MouthUpperUp*                          | mouthUpperLipRaise*     |
                           | MouthUpperDeepen*                      | noseNasolabialDeepen*   |
mouthLowerDown*            | MouthLowerDown*                        | mouthLowerLipDepress*   |
tongueOut                  | TongueOut                              | tongueOut               |
                           | TongueUp                               | tongueUp                |
                           | TongueDown                             | tongueDown              |
                           | TongueLeft                             | tongueLeft              |
                           | TongueRight                            | tongueRight             |
                           | TongueRoll                             |                         |
                           | TongueBendDown                         |                         |
                           | TongueCurlUp                           |                         |
                           | TongueSquish                           |                         |
                           | TongueFlat                             |                         |
                           | TongueTwist*                           |                         |
                           | SoftPalateClose                        |                         |
                           | ThroatSwallow                          |                         |
                           | NeckFlex*                              |                         |

makehuman
mouth-compression
mouth-depression-retraction
mouth-elevation
mouth-eversion
mouth-parling
mouth-part-later
mouth-protusion
mouth-retraction
mouth-upward-retraction
neck-platysma
nose-compression
nose-depression
nose-*-elevation

metahuman
browLateral*
earUp*
eyeLidPress*
eyeFaceScrunch*
eyeUpperLidUp*
eyeLowerLidUp*
eyeLowerLidDown*
eyeRelax*
eyelashesUpIN*
eyelashesUpOUT*
eyelashesDownIN*
eyelashesDownOUT*
noseWrinkleUpper*
noseNostrilDepress*
mouthLipsBlow*
mouthUp
mouthDown
mouthStretchLipsClose*
mouthPressU*
mouthPressD*
mouthLipsPress*
mouthLipsTightenU*
mouthLipsTightenD*
mouthLipsTogetherU*
mouthLipsTogetherD*
mouthLipsTowardsU*
mouthLipsTowardsD*
mouthUpperLipBite*
mouthLowerLipBite*
mouthStickyUC
mouthStickyUIN*
mouthStickyUOUT*
mouthStickyDC
mouthStickyDIN*
mouthStickyDOUT*
mouthLipsSticky*Ph1
mouthLipsSticky*Ph2
mouthLipsSticky*Ph3
mouthLipsPushU*
mouthLipsPushD*
mouthLipsPullU*
mouthLipsPullD*
mouthLipsThinU*
mouthLipsThinD*
mouthLipsThickU*
mouthLipsThickD*
mouthCornerSharpenU*
mouthCornerSharpenD*
mouthCornerRounderU*
mouthCornerRounderD*
mouthUpperLipTowardsTeeth*
mouthLowerLipTowardsTeeth*
mouthUpperLipRollOut*
mouthLowerLipRollOut*
mouthCornerUp*
mouthCornerDown*
mouthCornerWide*
mouthCornerNarrow*
tongueIn
tongueRollUp
tongueRollDown
tongueRollLeft
tongueRollRight
tongueTipUp
tongueTipDown
tongueTipLeft
tongueTipRight
tongueWide
tongueNarrow
tonguePress
jawClench*
jawChinRaiseU*
jawChinRaiseD*
jawChinCompress*
jawOpenExtreme
neckStretch*
neckSwallowPh1
neckSwallowPh2
neckSwallowPh3
neckSwallowPh4
neckMastoidContract*
neckThroatDown
neckThroatUp
neckDigastricDown
neckDigastricUp
neckThroatExhale
neckThroatInhale
teethUpU
teethUpD
teethDownU
teethDownD
teethLeftU
teethLeftD
teethRightU
teethRightD
teethFwdU
teethFwdD
teethBackU
teethBackD

arkit                    | unified                  | metahuman     | makehuman     | vrm1      | vrm0
eyeBlink*                | EyeClosed*               | eyeBlink*     | eye-*-closure | blink*    | blink*
eyeBlink&                | EyeClosed& / EyeClosed   | eyeBlink&     | eye-&-closure | blink     | blink
eyeLookUp&               | EyeLookUp&               | eyeLookUp&    |               | lookUp    | lookup
eyeLookDown&             | EyeLookDown&             | eyeLookDown&  |               | lookDown  | lookdown
eyeLook{OutLeft,InRight} | EyeLook{OutLeft,InRight} | eyeLookLeft&  |               | lookLeft  | lookleft
eyeLook{InLeft,OutRight} | EyeLook{InLeft,OutRight} | eyeLookRight& |               | lookRight | lookright

vrm1      | vrm0
happy     | joy
angry     | angry
sad       | sorrow
relaxed   | fun
surprised |
neutral   | neutral

oculus | vrchat | vrm1 | vrm0
sil    | sil    |      |
PP     | pp     |      |
FF     | ff     |      |
TH     | th     |      |
DD     | dd     |      |
kk     | kk     |      |
CH     | ch     |      |
SS     | ss     |      |
nn     | nn     |      |
RR     | rr     |      |
aa     | aa     | aa   | a
E      | e      | ee   | e
I / ih | ih     | ih   | i
O / oh | oh     | oh   | o
U / ou | ou     | ou   | u
"""

# The names whose keys add up to an expression.
Sum: TypeAlias = tuple[str, ...]


class Cell(NamedTuple):
    """An expression in a convention.

    Attributes:
        written: the name of its key; empty if the convention has no single key for it.
        sums: the keys, or sums of keys, that make this expression.
    """

    written: str
    sums: tuple[Sum, ...]


@cache
def read_table() -> tuple[Mapping[str, Cell], ...]:
    """The rows of the table, one for each side: cells by convention."""
    rows: list[Mapping[str, Cell]] = []
    for block in TABLE.strip().split("\n\n"):
        conventions, *lines = ([cell.strip() for cell in line.split("|")] for line in block.splitlines())
        for line in lines:
            for side in (0, 1) if any("*" in cell for cell in line) else (0,):
                rows.append(
                    {
                        convention: _read_cell(cell, convention, side)
                        for convention, cell in zip(conventions, line, strict=True)
                        if cell
                    }
                )
    return tuple(rows)


def _read_cell(cell: str, convention: str, side: int) -> Cell:
    """Read a cell of a row for the left side (0) or the right side (1)."""
    spelling = CONVENTIONS[convention]
    sides = spelling.left, spelling.right
    alternatives = [
        tuple(spelling.prefix + key for key in _expand(part.strip().replace("*", sides[side]), sides))
        for part in cell.split("/")
    ]
    first = alternatives[0]
    return Cell(first[0] if len(first) == 1 else "", tuple(filter(None, alternatives)))


def _expand(text: str, sides: Sequence[str]) -> Iterator[str]:
    """The keys that a part of a cell adds up."""
    if text:
        # Odd pieces are the alternatives within braces.
        pieces = re.split(r"\{(.*?)\}", text.replace("&", f"{{{','.join(sides)}}}"))
        choices = [piece.split(",") if number % 2 else [piece] for number, piece in enumerate(pieces)]
        yield from map("".join, product(*choices))
