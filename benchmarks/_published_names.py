"""Published names of shapes, with their counterparts in ARKit.

A line is ``ARKit > names``; ``<Left,Right>`` is expanded to both, on both sides of the sign. Lines
without the sign are names without a counterpart in ARKit.
"""

import re
from dataclasses import dataclass


@dataclass(frozen=True)
class Published:
    """Names of one source."""

    name: str
    source: str
    """Publication of the names and of their counterparts."""
    held_out: bool
    """Whether the list was not used when the rules were written."""
    lines: str

    def names(self) -> tuple[str, ...]:
        """Return every name, each once."""
        found = []
        for line in _spread(self.lines):
            found += line.rpartition(">")[2].split()
        return tuple(dict.fromkeys(found))

    def pairs(self) -> frozenset[tuple[str, str]]:
        """Return ARKit's names and their counterparts."""
        found = set()
        for line in _spread(self.lines):
            ours, sign, theirs = line.partition(">")
            if sign:
                found |= {(one, other) for one in ours.split() for other in theirs.split()}
        return frozenset(found)


def _spread(lines: str) -> list[str]:
    found = []
    for line in filter(None, map(str.strip, lines.splitlines())):
        if "<" in line:
            for side in (0, 1):
                found.append(re.sub(r"<([^>]*),([^>]*)>", rf"\{side + 1}", line))
        else:
            found.append(line)
    return found


PUBLISHED = (
    Published(
        "ICT FaceKit",
        "https://github.com/ICT-VGL/ICT-FaceKit",
        False,
        """
        eyeBlink<Left,Right> > eyeBlink_<L,R>
        eyeLookDown<Left,Right> > eyeLookDown_<L,R>
        eyeLookIn<Left,Right> > eyeLookIn_<L,R>
        eyeLookOut<Left,Right> > eyeLookOut_<L,R>
        eyeLookUp<Left,Right> > eyeLookUp_<L,R>
        eyeSquint<Left,Right> > eyeSquint_<L,R>
        eyeWide<Left,Right> > eyeWide_<L,R>
        jawForward > jawForward
        jaw<Left,Right> > jaw<Left,Right>
        jawOpen > jawOpen
        mouthClose > mouthClose
        mouthFunnel > mouthFunnel
        mouthPucker > mouthPucker
        mouth<Left,Right> > mouth<Left,Right>
        mouthSmile<Left,Right> > mouthSmile_<L,R>
        mouthFrown<Left,Right> > mouthFrown_<L,R>
        mouthDimple<Left,Right> > mouthDimple_<L,R>
        mouthStretch<Left,Right> > mouthStretch_<L,R>
        mouthRoll<Lower,Upper> > mouthRoll<Lower,Upper>
        mouthShrug<Lower,Upper> > mouthShrug<Lower,Upper>
        mouthPress<Left,Right> > mouthPress_<L,R>
        mouthLowerDown<Left,Right> > mouthLowerDown_<L,R>
        mouthUpperUp<Left,Right> > mouthUpperUp_<L,R>
        browDown<Left,Right> > browDown_<L,R>
        browInnerUp > browInnerUp_L browInnerUp_R
        browOuterUp<Left,Right> > browOuterUp_<L,R>
        cheekPuff > cheekPuff_L cheekPuff_R
        cheekSquint<Left,Right> > cheekSquint_<L,R>
        noseSneer<Left,Right> > noseSneer_<L,R>
        cheekRaiser_<L,R>
        """,
    ),
    Published(
        "Character Creator 4",
        "Reallusion, Extended Facial Blendshapes; counterparts as its Live Link plug-in has them",
        False,
        """
        browInnerUp > Brow_Raise_Inner_L Brow_Raise_Inner_R
        browOuterUp<Left,Right> > Brow_Raise_Outer_<L,R>
        browDown<Left,Right> > Brow_Drop_<L,R>
        eyeBlink<Left,Right> > Eye_Blink_<L,R>
        eyeSquint<Left,Right> > Eye_Squint_<L,R>
        eyeWide<Left,Right> > Eye_Wide_<L,R>
        eyeLookOut<Left,Right> > Eye_<L,R>_Look_<L,R>
        eyeLookIn<Left,Right> > Eye_<L,R>_Look_<R,L>
        eyeLookUp<Left,Right> > Eye_<L,R>_Look_Up
        eyeLookDown<Left,Right> > Eye_<L,R>_Look_Down
        noseSneer<Left,Right> > Nose_Sneer_<L,R>
        cheekSquint<Left,Right> > Cheek_Raise_<L,R>
        cheekPuff > Cheek_Puff_L Cheek_Puff_R
        mouthSmile<Left,Right> > Mouth_Smile_<L,R>
        mouthFrown<Left,Right> > Mouth_Frown_<L,R>
        mouthStretch<Left,Right> > Mouth_Stretch_<L,R>
        mouthDimple<Left,Right> > Mouth_Dimple_<L,R>
        mouthPress<Left,Right> > Mouth_Press_<L,R>
        mouthPucker > Mouth_Pucker_Up_L Mouth_Pucker_Up_R Mouth_Pucker_Down_L Mouth_Pucker_Down_R
        mouthFunnel > Mouth_Funnel_Up_L Mouth_Funnel_Up_R Mouth_Funnel_Down_L Mouth_Funnel_Down_R
        mouthRoll<Upper,Lower> > Mouth_Roll_In_<Upper,Lower>_L Mouth_Roll_In_<Upper,Lower>_R
        mouth<Left,Right> > Mouth_<L,R>
        mouthShrug<Upper,Lower> > Mouth_Shrug_<Upper,Lower>
        mouthUpperUp<Left,Right> > Mouth_Up_Upper_<L,R>
        mouthLowerDown<Left,Right> > Mouth_Down_Lower_<L,R>
        mouthClose > Mouth_Close
        jawOpen > Jaw_Open
        jawForward > Jaw_Forward
        jaw<Left,Right> > Jaw_<L,R>
        tongueOut > Tongue_Out
        Brow_Compress_L Brow_Compress_R Ear_Up_L Ear_Up_R Ear_Down_L Ear_Down_R Ear_Out_L Ear_Out_R
        Nose_Nostril_Raise_L Nose_Nostril_Raise_R Nose_Nostril_Dilate_L Nose_Nostril_Dilate_R
        Nose_Crease_L Nose_Crease_R Nose_Nostril_Down_L Nose_Nostril_Down_R Nose_Nostril_In_L
        Nose_Nostril_In_R Nose_Tip_L Nose_Tip_R Nose_Tip_Up Nose_Tip_Down Cheek_Suck_L Cheek_Suck_R
        Mouth_Smile_Sharp_L Mouth_Smile_Sharp_R Mouth_Tighten_L Mouth_Tighten_R Mouth_Blow_L
        Mouth_Blow_R Mouth_Roll_Out_Upper_L Mouth_Roll_Out_Upper_R Mouth_Roll_Out_Lower_L
        Mouth_Roll_Out_Lower_R Mouth_Push_Upper_L Mouth_Push_Upper_R Mouth_Push_Lower_L
        Mouth_Push_Lower_R Mouth_Pull_Upper_L Mouth_Pull_Upper_R Mouth_Pull_Lower_L
        Mouth_Pull_Lower_R Mouth_Up Mouth_Down Mouth_Upper_L Mouth_Upper_R Mouth_Lower_L
        Mouth_Lower_R Mouth_Drop_Upper Mouth_Drop_Lower Mouth_Chin_Up Mouth_Contract Tongue_Bulge_L
        Tongue_Bulge_R Jaw_Backward Jaw_Up Jaw_Down Neck_Swallow_Up Neck_Swallow_Down
        Neck_Tighten_L Neck_Tighten_R Head_Turn_Up Head_Turn_Down Head_Turn_L Head_Turn_R
        """,
    ),
    Published(
        "MetaHuman",
        "Epic's raw controls and PA_MetaHuman_ARKit_Mapping, as listed in "
        "https://github.com/Dylanyz/ARKitRemap; mouthClose as Epic's Live Link graph has it",
        False,
        """
        eyeBlink<Left,Right> > CTRL_expressions_eyeBlink<L,R>
        eyeLookDown<Left,Right> > CTRL_expressions_eyeLookDown<L,R>
        eyeLookUp<Left,Right> > CTRL_expressions_eyeLookUp<L,R>
        eyeLookIn<Left,Right> > CTRL_expressions_eyeLook<RightL,LeftR>
        eyeLookOut<Left,Right> > CTRL_expressions_eyeLook<LeftL,RightR>
        eyeSquint<Left,Right> > CTRL_expressions_eyeSquintInner<L,R>
        eyeWide<Left,Right> > CTRL_expressions_eyeWiden<L,R>
        jawForward > CTRL_expressions_jawFwd
        jaw<Left,Right> > CTRL_expressions_jaw<Left,Right>
        jawOpen > CTRL_expressions_jawOpen
        mouthClose > CTRL_expressions_mouthLipsTogetherUL CTRL_expressions_mouthLipsTogetherUR
        mouthClose > CTRL_expressions_mouthLipsTogetherDL CTRL_expressions_mouthLipsTogetherDR
        mouthFunnel mouthPucker > CTRL_expressions_mouthFunnelU<L,R>
        mouthFunnel mouthPucker > CTRL_expressions_mouthFunnelD<L,R>
        mouthPucker > CTRL_expressions_mouthLipsPurseU<L,R> CTRL_expressions_mouthLipsPurseD<L,R>
        mouthPucker > CTRL_expressions_mouthLipsTowardsU<L,R>
        mouthPucker > CTRL_expressions_mouthLipsTowardsD<L,R>
        mouth<Left,Right> > CTRL_expressions_mouth<Left,Right>
        mouthSmile<Left,Right> > CTRL_expressions_mouthCornerPull<L,R>
        mouthFrown<Left,Right> > CTRL_expressions_mouthCornerDepress<L,R>
        mouthDimple<Left,Right> > CTRL_expressions_mouthDimple<L,R>
        mouthStretch<Left,Right> > CTRL_expressions_mouthStretch<L,R>
        mouthRollLower > CTRL_expressions_mouthLowerLipRollIn<L,R>
        mouthRollLower mouthRollUpper > CTRL_expressions_mouthUpperLipRollIn<L,R>
        mouthShrugLower > CTRL_expressions_jawChinRaiseD<L,R>
        mouthShrugUpper > CTRL_expressions_jawChinRaiseU<L,R>
        mouthPress<Left,Right> > CTRL_expressions_mouthPressU<L,R> CTRL_expressions_mouthPressD<L,R>
        mouthLowerDown<Left,Right> > CTRL_expressions_mouthLowerLipDepress<L,R>
        mouthUpperUp<Left,Right> > CTRL_expressions_mouthUpperLipRaise<L,R>
        browDown<Left,Right> > CTRL_expressions_browDown<L,R>
        browInnerUp > CTRL_expressions_browLateral<L,R> CTRL_expressions_browRaiseIn<L,R>
        browOuterUp<Left,Right> > CTRL_expressions_browRaiseIn<L,R>
        browOuterUp<Left,Right> > CTRL_expressions_browRaiseOuter<L,R>
        cheekPuff > CTRL_expressions_mouthCheekBlow<L,R> CTRL_expressions_mouthLipsBlow<L,R>
        cheekSquint<Left,Right> > CTRL_expressions_eyeCheekRaise<L,R>
        noseSneer<Left,Right> > CTRL_expressions_noseWrinkle<L,R>
        tongueOut > CTRL_expressions_tongueOut CTRL_expressions_tongueDown
        tongueOut > CTRL_expressions_tongueWide CTRL_expressions_tongueRollDown
        CTRL_expressions_mouthCheekSuck<L,R> CTRL_expressions_mouthLipsPress<L,R>
        CTRL_expressions_mouthUp CTRL_expressions_mouthDown CTRL_expressions_jawOpenExtreme
        CTRL_expressions_mouthUpperLipBite<L,R> CTRL_expressions_mouthLowerLipBite<L,R>
        CTRL_expressions_mouthLipsTightenU<L,R> CTRL_expressions_mouthLipsTightenD<L,R>
        CTRL_expressions_mouthSharpCornerPull<L,R> CTRL_expressions_mouthCornerUp<L,R>
        CTRL_expressions_mouthLipsPushU<L,R> CTRL_expressions_mouthLipsPullD<L,R>
        CTRL_expressions_mouthCornerDown<L,R> CTRL_expressions_noseWrinkleUpper<L,R>
        CTRL_expressions_mouthLowerLipRollOut<L,R> CTRL_expressions_mouthUpperLipRollOut<L,R>
        CTRL_expressions_mouthUpperLipShift<Left,Right> CTRL_expressions_jawBack
        CTRL_expressions_jawChinCompress<L,R> CTRL_expressions_tongueUp CTRL_expressions_tongueIn
        CTRL_expressions_mouthStickyUIN<L,R> CTRL_expressions_mouthCornerSharpenU<L,R>
        CTRL_expressions_noseNostrilDilate<L,R> CTRL_expressions_eyeUpperLidUp<L,R>
        CTRL_expressions_eyeFaceScrunch<L,R> CTRL_expressions_eyeRelax<L,R>
        """,
    ),
    Published(
        "MPFB",
        "MakeHuman's and MPFB's expression units, data/targets/expression/units",
        False,
        """
        eyeBlink<Left,Right> > eye-<left,right>-closure
        eyeWide<Left,Right> > eye-<left,right>-opened-up
        eyeSquint<Left,Right> > eye-<left,right>-slit
        browDown<Left,Right> > eyebrows-<left,right>-down
        browOuterUp<Left,Right> > eyebrows-<left,right>-extern-up
        browInnerUp > eyebrows-<left,right>-inner-up
        jawOpen > mouth-open
        mouthSmileLeft mouthSmileRight > mouth-corner-puller
        mouthFrownLeft mouthFrownRight > mouth-depression
        mouthPressLeft mouthPressRight > mouth-compression
        mouthStretchLeft mouthStretchRight > mouth-retraction
        mouthPucker > mouth-pursing
        mouthFunnel > mouth-protusion
        noseSneer<Left,Right> > nose-<left,right>-elevation
        eyebrows-left-up eyebrows-right-up mouth-depression-retraction mouth-elevation
        mouth-eversion mouth-parling mouth-part-later mouth-upward-retraction neck-platysma
        nose-compression
        nose-depression nose-left-dilatation nose-right-dilatation
        """,
    ),
    Published(
        "FACEGOOD",
        "https://github.com/FACEGOOD/FACEGOOD-Audio2Face; mouth, blinks and looks down as its "
        "makers' table to ARKit has them (Voice2Face_blendshape2ARkit.xlsx), the rest by the "
        "action units that it is named after",
        False,
        """
        jawForward > jaw_thrust_c
        jaw<Left,Right> > jaw_sideways_<l,r>
        jawOpen > mouth_stretch_c
        mouthClose > mouth_chew_c
        mouth<Left,Right> > mouth_sideways_<l,r>
        mouthSmile<Left,Right> > mouth_lipCornerPull_<l,r>
        mouthDimple<Left,Right> > mouth_dimple_<l,r>
        mouthStretch<Left,Right> > mouth_lipStretch_<l,r>
        mouthShrugLower > mouth_chinRaise_d
        mouthShrugUpper > mouth_chinRaise_u
        mouthPress<Left,Right> > mouth_press_<l,r>
        mouthLowerDown<Left,Right> > mouth_lowerLipDepress_<l,r>
        mouthUpperUp<Left,Right> > mouth_upperLipRaise_<l,r>
        mouthFunnel > mouth_funnel_d<l,r> mouth_funnel_u<l,r>
        mouthPucker > mouth_pucker_<l,r>
        mouthFrown<Left,Right> > mouth_lipCornerDepress_<l,r>
        mouthRollLower > mouth_suck_d<l,r>
        mouthRollUpper > mouth_suck_u<l,r>
        browDown<Left,Right> > brow_lower_<l,r>
        browInnerUp > brow_raise_c
        browOuterUp<Left,Right> > brow_raise_<l,r>
        cheekPuff > cheek_puff_<l,r>
        cheekSquint<Left,Right> > cheek_raise_<l,r>
        eyeSquint<Left,Right> > eye_lidTight_<l,r>
        eyeWide<Left,Right> > eye_upperLidRaise_<l,r>
        noseSneer<Left,Right> > nose_wrinkle_<l,r>
        eyeLookOut<Left,Right> > eye_look<Left_l,Right_r>
        eyeLookIn<Left,Right> > eye_look<Right_l,Left_r>
        eyeLookUp<Left,Right> > eye_lookUp_<l,r>
        eyeBlink<Left,Right> > eye_blink2_<l,r>
        eyeLookDown<Left,Right> > eye_lookDown2_<l,r>
        eye_blink1_<l,r> eye_shutTight_<l,r> eye_downLidRaise_<l,r> eye_lookDown1_<l,r>
        cheek_suck_<l,r> mouth_lipCornerDepressFix_<l,r> mouth_lipCornerPullOpen_<l,r>
        mouth_lipStretchOpen_<l,r> mouth_lowerLipProtrude_c mouth_oh_c mouth_oo_c mouth_pressFix_c
        mouth_screamFix_c tongue_u tongue_d nose_out_<l,r>
        """,
    ),
    Published(
        "Meta (XR_FB_face_tracking)",
        "https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrFaceExpressionFB.html; "
        "counterparts by the action units in its names",
        False,
        """
        browDown<Left,Right> > BROW_LOWERER_<L,R>_FB
        cheekPuff > CHEEK_PUFF_<L,R>_FB
        cheekSquint<Left,Right> > CHEEK_RAISER_<L,R>_FB
        mouthShrugLower > CHIN_RAISER_B_FB
        mouthShrugUpper > CHIN_RAISER_T_FB
        mouthDimple<Left,Right> > DIMPLER_<L,R>_FB
        eyeBlink<Left,Right> > EYES_CLOSED_<L,R>_FB
        eyeLookDown<Left,Right> > EYES_LOOK_DOWN_<L,R>_FB
        eyeLookUp<Left,Right> > EYES_LOOK_UP_<L,R>_FB
        eyeLookOut<Left,Right> > EYES_LOOK_<LEFT,RIGHT>_<L,R>_FB
        eyeLookIn<Left,Right> > EYES_LOOK_<RIGHT,LEFT>_<L,R>_FB
        browInnerUp > INNER_BROW_RAISER_<L,R>_FB
        jawOpen > JAW_DROP_FB
        jaw<Left,Right> > JAW_SIDEWAYS_<LEFT,RIGHT>_FB
        jawForward > JAW_THRUST_FB
        eyeSquint<Left,Right> > LID_TIGHTENER_<L,R>_FB
        mouthFrown<Left,Right> > LIP_CORNER_DEPRESSOR_<L,R>_FB
        mouthSmile<Left,Right> > LIP_CORNER_PULLER_<L,R>_FB
        mouthFunnel > LIP_FUNNELER_LB_FB LIP_FUNNELER_LT_FB LIP_FUNNELER_RB_FB LIP_FUNNELER_RT_FB
        mouthPress<Left,Right> > LIP_PRESSOR_<L,R>_FB
        mouthPucker > LIP_PUCKER_<L,R>_FB
        mouthStretch<Left,Right> > LIP_STRETCHER_<L,R>_FB
        mouthRollLower > LIP_SUCK_LB_FB LIP_SUCK_RB_FB
        mouthRollUpper > LIP_SUCK_LT_FB LIP_SUCK_RT_FB
        mouthClose > LIPS_TOWARD_FB
        mouthLowerDown<Left,Right> > LOWER_LIP_DEPRESSOR_<L,R>_FB
        mouth<Left,Right> > MOUTH_<LEFT,RIGHT>_FB
        noseSneer<Left,Right> > NOSE_WRINKLER_<L,R>_FB
        browOuterUp<Left,Right> > OUTER_BROW_RAISER_<L,R>_FB
        eyeWide<Left,Right> > UPPER_LID_RAISER_<L,R>_FB
        mouthUpperUp<Left,Right> > UPPER_LIP_RAISER_<L,R>_FB
        CHEEK_SUCK_<L,R>_FB LIP_TIGHTENER_<L,R>_FB
        """,
    ),
    Published(
        "FACS codes",
        "Ekman, Friesen and Hager (2002), by side",
        False,
        """
        browInnerUp > AU1_<L,R>
        browOuterUp<Left,Right> > AU2_<L,R>
        browDown<Left,Right> > AU4_<L,R>
        eyeWide<Left,Right> > AU5_<L,R>
        cheekSquint<Left,Right> > AU6_<L,R>
        eyeSquint<Left,Right> > AU7_<L,R>
        mouthClose > AU8
        noseSneer<Left,Right> > AU9_<L,R>
        mouthUpperUp<Left,Right> > AU10_<L,R>
        mouthSmile<Left,Right> > AU12_<L,R>
        mouthDimple<Left,Right> > AU14_<L,R>
        mouthFrown<Left,Right> > AU15_<L,R>
        mouthLowerDown<Left,Right> > AU16_<L,R>
        mouthShrugLower > AU17
        mouthPucker > AU18
        tongueOut > AU19
        mouthStretch<Left,Right> > AU20_<L,R>
        mouthFunnel > AU22
        mouthPress<Left,Right> > AU24_<L,R>
        jawOpen > AU26
        mouthRollLower mouthRollUpper > AU28
        jawForward > AU29
        cheekPuff > AU34
        eyeBlink<Left,Right> > AU45_<L,R>
        AU11_<L,R> AU13_<L,R> AU21 AU23 AU25 AU27 AU31 AU32 AU35 AU36 AU37 AU38 AU39 AU43 AU46
        """,
    ),
    Published(
        "Faceshift",
        "faceshift studio, as Vircadia lists them; rules made without it found 28 of 46, and took "
        "two lips that close for parts of mouthClose",
        False,
        """
        eyeBlink<Left,Right> > EyeBlink_<L,R>
        eyeSquint<Left,Right> > EyeSquint_<L,R>
        eyeLookDown<Left,Right> > EyeDown_<L,R>
        eyeLookIn<Left,Right> > EyeIn_<L,R>
        eyeWide<Left,Right> > EyeOpen_<L,R>
        eyeLookOut<Left,Right> > EyeOut_<L,R>
        eyeLookUp<Left,Right> > EyeUp_<L,R>
        browDown<Left,Right> > BrowsD_<L,R>
        browInnerUp > BrowsU_C
        browOuterUp<Left,Right> > BrowsU_<L,R>
        jawForward > JawFwd
        jaw<Left,Right> > Jaw<Left,Right>
        jawOpen > JawOpen
        mouthClose > JawChew
        mouth<Left,Right> > Mouth<Left,Right>
        mouthFrown<Left,Right> > MouthFrown_<L,R>
        mouthSmile<Left,Right> > MouthSmile_<L,R>
        mouthDimple<Left,Right> > MouthDimple_<L,R>
        mouthStretch<Left,Right> > LipsStretch_<L,R>
        mouthRollUpper > LipsUpperClose
        mouthRollLower > LipsLowerClose
        mouthUpperUpLeft mouthUpperUpRight > LipsUpperUp
        mouthLowerDownLeft mouthLowerDownRight > LipsLowerDown
        mouthFunnel > LipsFunnel
        mouthPucker > LipsPucker
        mouthShrugLower > ChinLowerRaise
        mouthShrugUpper > ChinUpperRaise
        noseSneerLeft noseSneerRight > Sneer
        cheekPuff > Puff
        cheekSquint<Left,Right> > CheekSquint_<L,R>
        LipsUpperOpen LipsLowerOpen
        """,
    ),
    Published(
        "VRoid",
        "VRoid Studio; eyelids alone have a counterpart that nobody doubts",
        False,
        """
        eyeBlink<Left,Right> > Fcl_EYE_Close_<L,R>
        """,
    ),
    Published(
        "Roblox FaceControls",
        "https://create.roblox.com/docs/reference/engine/classes/FaceControls; counterparts by the "
        "action units in its names",
        True,
        """
        mouthShrugUpper > ChinRaiserUpperLip
        mouthShrugLower > ChinRaiser
        mouthFunnel > Funneler
        mouthRollLower > LowerLipSuck
        mouthRollUpper > UpperLipSuck
        mouthPressLeft mouthPressRight > LipPresser
        mouthClose > LipsTogether
        mouth<Left,Right> > Mouth<Left,Right>
        mouthPucker > Pucker
        cheekPuff > <Left,Right>CheekPuff
        mouthDimple<Left,Right> > <Left,Right>Dimpler
        mouthFrown<Left,Right> > <Left,Right>LipCornerDown
        mouthLowerDown<Left,Right> > <Left,Right>LowerLipDepressor
        mouthSmile<Left,Right> > <Left,Right>LipCornerPuller
        mouthStretch<Left,Right> > <Left,Right>LipStretcher
        mouthUpperUp<Left,Right> > <Left,Right>UpperLipRaiser
        jawOpen > JawDrop
        jaw<Left,Right> > Jaw<Left,Right>
        browDown<Left,Right> > <Left,Right>BrowLowerer
        browOuterUp<Left,Right> > <Left,Right>OuterBrowRaiser
        browInnerUp > <Left,Right>InnerBrowRaiser
        noseSneer<Left,Right> > <Left,Right>NoseWrinkler
        eyeLookDownLeft eyeLookDownRight > EyesLookDown
        eyeLookUpLeft eyeLookUpRight > EyesLookUp
        eyeLookOutLeft eyeLookInRight > EyesLookLeft
        eyeLookInLeft eyeLookOutRight > EyesLookRight
        cheekSquint<Left,Right> > <Left,Right>CheekRaiser
        eyeWide<Left,Right> > <Left,Right>EyeUpperLidRaiser
        eyeBlink<Left,Right> > <Left,Right>EyeClosed
        tongueOut > TongueOut
        FlatPucker Corrugator TongueDown TongueUp
        """,
    ),
    Published(
        "Unified Expressions",
        "https://github.com/benaclejames/VRCFaceTracking, UnifiedExpressions.cs; counterparts by "
        "its comments on the muscles",
        True,
        """
        eyeLookOut<Left,Right> > EyeLookOut<Left,Right>
        eyeLookIn<Left,Right> > EyeLookIn<Left,Right>
        eyeLookUp<Left,Right> > EyeLookUp<Left,Right>
        eyeLookDown<Left,Right> > EyeLookDown<Left,Right>
        eyeBlink<Left,Right> > EyeClosed<Left,Right>
        eyeSquint<Left,Right> > EyeSquint<Left,Right>
        eyeWide<Left,Right> > EyeWide<Left,Right>
        browDown<Left,Right> > BrowLowerer<Left,Right>
        browInnerUp > BrowInnerUp<Left,Right>
        browOuterUp<Left,Right> > BrowOuterUp<Left,Right>
        cheekSquint<Left,Right> > CheekSquint<Left,Right>
        cheekPuff > CheekPuff<Left,Right>
        jawOpen > JawOpen
        jaw<Left,Right> > Jaw<Left,Right>
        jawForward > JawForward
        mouthClose > MouthClosed
        mouthRollUpper > LipSuckUpper<Left,Right>
        mouthRollLower > LipSuckLower<Left,Right>
        mouthFunnel > LipFunnelUpper<Left,Right> LipFunnelLower<Left,Right>
        mouthPucker > LipPuckerUpper<Left,Right> LipPuckerLower<Left,Right>
        mouthUpperUp<Left,Right> > MouthUpperUp<Left,Right>
        noseSneer<Left,Right> > NoseSneer<Left,Right>
        mouthLowerDown<Left,Right> > MouthLowerDown<Left,Right>
        mouth<Left,Right> > MouthUpper<Left,Right> MouthLower<Left,Right>
        mouthSmile<Left,Right> > MouthCornerPull<Left,Right>
        mouthFrown<Left,Right> > MouthFrown<Left,Right>
        mouthStretch<Left,Right> > MouthStretch<Left,Right>
        mouthDimple<Left,Right> > MouthDimple<Left,Right>
        mouthShrugUpper > MouthRaiserUpper
        mouthShrugLower > MouthRaiserLower
        mouthPress<Left,Right> > MouthPress<Left,Right>
        tongueOut > TongueOut
        EyeDilation<Left,Right> EyeConstrict<Left,Right> BrowPinch<Left,Right> JawClench
        NasalDilation<Left,Right> NasalConstrict<Left,Right> CheekSuck<Left,Right> JawBackward
        JawMandibleRaise LipSuckCorner<Left,Right> MouthUpperDeepen<Left,Right>
        MouthCornerSlant<Left,Right> MouthTightener<Left,Right> TongueUp TongueDown TongueRight
        TongueLeft TongueRoll TongueBendDown TongueCurlUp TongueSquish TongueFlat
        TongueTwist<Left,Right> SoftPalateClose ThroatSwallow NeckFlex<Left,Right>
        """,
    ),
    Published(
        "SRanipal",
        "HTC's LipShape_v2; counterparts as converters between it, ARKit and "
        "XR_HTC_facial_tracking have them",
        True,
        """
        jaw<Left,Right> > Jaw_<Left,Right>
        jawForward > Jaw_Forward
        jawOpen > Jaw_Open
        mouth<Left,Right> > Mouth_Upper_<Left,Right> Mouth_Lower_<Left,Right>
        mouthPucker > Mouth_Pout
        mouthSmile<Left,Right> > Mouth_Smile_<Left,Right>
        mouthFrown<Left,Right> > Mouth_Sad_<Left,Right>
        cheekPuff > Cheek_Puff_<Left,Right>
        mouthUpperUp<Left,Right> > Mouth_Upper_Up<Left,Right>
        mouthLowerDown<Left,Right> > Mouth_Lower_Down<Left,Right>
        mouthRoll<Upper,Lower> > Mouth_<Upper,Lower>_Inside
        Mouth_Ape_Shape Mouth_Upper_Overturn Mouth_Lower_Overturn Cheek_Suck Mouth_Lower_Overlay
        Tongue_LongStep1 Tongue_LongStep2 Tongue_Down Tongue_Up Tongue_Right Tongue_Left Tongue_Roll
        Tongue_UpLeft_Morph Tongue_UpRight_Morph Tongue_DownLeft_Morph Tongue_DownRight_Morph
        """,
    ),
    Published(
        "DAZ Genesis 9",
        "facs_bs_* of the base figure; counterparts as its users' converters have them",
        True,
        """
        browDown<Left,Right> > facs_bs_BrowDown<Left,Right>
        browInnerUp > facs_bs_BrowInnerUp<Left,Right>
        browOuterUp<Left,Right> > facs_bs_BrowOuterUp<Left,Right>
        cheekPuff > facs_bs_CheekPuff<Left,Right>
        cheekSquint<Left,Right> > facs_bs_CheekSquint<Left,Right>
        eyeBlink<Left,Right> > facs_bs_EyeBlink<Left,Right>
        eyeLookDown<Left,Right> > facs_bs_EyeLookDown<Left,Right>
        eyeLookIn<Left,Right> > facs_bs_EyeLookIn<Left,Right>
        eyeLookOut<Left,Right> > facs_bs_EyeLookOut<Left,Right>
        eyeLookUp<Left,Right> > facs_bs_EyeLookUp<Left,Right>
        eyeSquint<Left,Right> > facs_bs_EyeSquint<Left,Right>
        jawForward > facs_bs_JawForward
        jaw<Left,Right> > facs_bs_Jaw<Left,Right>
        jawOpen > facs_bs_JawOpen
        mouthClose > facs_bs_MouthCloseUpper<Left,Right> facs_bs_MouthCloseLower<Left,Right>
        mouthDimple<Left,Right> > facs_bs_MouthDimple<Left,Right>
        mouthFrown<Left,Right> > facs_bs_MouthFrown<Left,Right>
        mouthFunnel > facs_bs_MouthFunnelUpper<Left,Right> facs_bs_MouthFunnelLower<Left,Right>
        mouthShrugUpper > facs_bs_MouthShrugUpper<Left,Right>
        mouthShrugLower > facs_bs_MouthShrugLower<Left,Right>
        mouthUpperUp<Left,Right> > facs_bs_MouthUpperUp<Left,Right>
        mouthLowerDown<Left,Right> > facs_bs_MouthLowerDown<Left,Right>
        mouthStretch<Left,Right> > facs_bs_MouthStretch<Left,Right>
        tongueOut > facs_bs_TongueOut
        facs_bs_BrowSqueeze<Left,Right> facs_bs_CheekInflate<Left,Right>
        facs_bs_CheekHollow<Left,Right> facs_bs_JawRecess facs_bs_JawChinCompression
        """,
    ),
    Published(
        "Mixamo (Adobe Fuse)",
        "shapes of Fuse characters, written from memory of its documentation",
        True,
        """
        eyeBlink<Left,Right> > Blink_<Left,Right>
        browDown<Left,Right> > BrowsDown_<Left,Right>
        cheekPuff > CheekPuff_<Left,Right>
        eyeWide<Left,Right> > EyesWide_<Left,Right>
        mouthFrown<Left,Right> > Frown_<Left,Right>
        jawForward > JawForeward
        jaw<Left,Right> > Jaw_<Left,Right>
        jawOpen > MouthOpen
        mouthLowerDown<Left,Right> > LowerLipDown_<Left,Right>
        mouthRoll<Upper,Lower> > <Upper,Lower>LipIn
        mouthUpperUp<Left,Right> > UpperLipUp_<Left,Right>
        noseSneer<Left,Right> > NoseScrunch_<Left,Right>
        mouthSmile<Left,Right> > Smile_<Left,Right>
        eyeSquint<Left,Right> > Squint_<Left,Right>
        BrowsIn_<Left,Right> BrowsOuterLower_<Left,Right> JawBackward JawRotateY_<Left,Right>
        JawRotateZ_<Left,Right> JawUp JawDown LowerLipOut UpperLipOut MouthDown MouthUp
        MouthNarrow_<Left,Right> MouthWhistle_NarrowAdjust_<Left,Right> TongueUp
        """,
    ),
    Published(
        "Character Creator 3, ARKit profile",
        "Reallusion's iPhone profile: A01 to A52",
        True,
        """
        browInnerUp > A01_Brow_Inner_Up
        browDown<Left,Right> > A0<2,3>_Brow_Down_<Left,Right>
        browOuterUp<Left,Right> > A0<4,5>_Brow_Outer_Up_<Left,Right>
        eyeLookUp<Left,Right> > A0<6,7>_Eye_Look_Up_<Left,Right>
        eyeLookDown<Left,Right> > A0<8,9>_Eye_Look_Down_<Left,Right>
        eyeLookOutLeft > A10_Eye_Look_Out_Left
        eyeLookIn<Left,Right> > A1<1,2>_Eye_Look_In_<Left,Right>
        eyeLookOutRight > A13_Eye_Look_Out_Right
        eyeBlink<Left,Right> > A1<4,5>_Eye_Blink_<Left,Right>
        eyeSquint<Left,Right> > A1<6,7>_Eye_Squint_<Left,Right>
        eyeWide<Left,Right> > A1<8,9>_Eye_Wide_<Left,Right>
        cheekPuff > A20_Cheek_Puff
        cheekSquint<Left,Right> > A2<1,2>_Cheek_Squint_<Left,Right>
        noseSneer<Left,Right> > A2<3,4>_Nose_Sneer_<Left,Right>
        jawOpen > A25_Jaw_Open
        jawForward > A26_Jaw_Forward
        jaw<Left,Right> > A2<7,8>_Jaw_<Left,Right>
        mouthFunnel > A29_Mouth_Funnel
        mouthPucker > A30_Mouth_Pucker
        mouth<Left,Right> > A3<1,2>_Mouth_<Left,Right>
        mouthRoll<Upper,Lower> > A3<3,4>_Mouth_Roll_<Upper,Lower>
        mouthShrug<Upper,Lower> > A3<5,6>_Mouth_Shrug_<Upper,Lower>
        mouthClose > A37_Mouth_Close
        mouthSmile<Left,Right> > A3<8,9>_Mouth_Smile_<Left,Right>
        mouthFrown<Left,Right> > A4<0,1>_Mouth_Frown_<Left,Right>
        mouthDimple<Left,Right> > A4<2,3>_Mouth_Dimple_<Left,Right>
        mouthUpperUp<Left,Right> > A4<4,5>_Mouth_Upper_Up_<Left,Right>
        mouthLowerDown<Left,Right> > A4<6,7>_Mouth_Lower_Down_<Left,Right>
        mouthPress<Left,Right> > A4<8,9>_Mouth_Press_<Left,Right>
        mouthStretch<Left,Right> > A5<0,1>_Mouth_Stretch_<Left,Right>
        tongueOut > A52_Tongue_Out
        """,
    ),
    Published(
        "VRM 0",
        "@pixiv/types-vrm-0.0 on npm, BlendShapePresetName; a lid of both sides has none "
        "where each side has its own",
        True,
        """
        eyeBlink<Left,Right> > blink_<l,r>
        eyeLookUpLeft eyeLookUpRight > lookup
        eyeLookDownLeft eyeLookDownRight > lookdown
        eyeLookOutLeft eyeLookInRight > lookleft
        eyeLookInLeft eyeLookOutRight > lookright
        a angry blink e fun i joy neutral o sorrow u unknown
        """,
    ),
    Published(
        "VRM 1",
        "@pixiv/three-vrm-core on npm, VRMExpressionPresetName; as VRM 0",
        True,
        """
        eyeBlink<Left,Right> > blink<Left,Right>
        eyeLookUpLeft eyeLookUpRight > lookUp
        eyeLookDownLeft eyeLookDownRight > lookDown
        eyeLookOutLeft eyeLookInRight > lookLeft
        eyeLookInLeft eyeLookOutRight > lookRight
        aa ih ou ee oh blink happy angry sad relaxed surprised neutral
        """,
    ),
    Published(
        "Ready Player Me, without ARKit's shapes",
        "@met4citizen/talkinghead on npm: what avatars have beside visemes; counterparts as "
        "its mtExtras make them from ARKit's",
        True,
        """
        jawOpen > mouthOpen
        mouthSmileLeft mouthSmileRight > mouthSmile
        eyeBlinkLeft eyeBlinkRight > eyesClosed
        eyeLookUpLeft eyeLookUpRight > eyesLookUp
        eyeLookDownLeft eyeLookDownRight > eyesLookDown
        viseme_sil viseme_PP viseme_FF viseme_TH viseme_DD viseme_kk viseme_CH viseme_SS
        viseme_nn viseme_RR viseme_aa viseme_E viseme_I viseme_O viseme_U
        """,
    ),
)
