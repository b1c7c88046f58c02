"""The catalogue of a robot's physical effects: a name of the vocabulary, or a variant of one, a line."""

from robot_model.effects import drift, elastic, sensed, tilt, transmission

CATALOGUE = {
    "transmission-harmonic": transmission.TransmissionHarmonic,
    "zero-offset": transmission.ConstantTerm,
    "axis-run-out": drift.AxisRunOut,
    "joint-coupling": transmission.JointCoupling,
    "zero-shift": transmission.ZeroShift,
    "joint-compliance": elastic.JointCompliance,
    "ye-compliance": elastic.YeCompliance,
    "backlash": transmission.Backlash,
    "joint-thermal-drift": transmission.JointThermalDrift,
    "link-thermal-growth": drift.LinkThermalGrowth,
    "link-self-weight": elastic.LinkSelfWeight,
    "link-compliance": elastic.LinkCompliance,
    "bearing-compliance": elastic.BearingCompliance,
    "first-moment": elastic.FirstMoment,
    "pedestal-compliance": elastic.PedestalCompliance,
    "base-drift": drift.BaseDrift,
    "mount-tilt": elastic.MountTilt,
    "mount-tilt-torsion": elastic.MountTorsion,
    "tool-deflection": elastic.ToolDeflection,
    "measured-tilt": tilt.MeasuredTilt,
    "range-scale": sensed.RangeScale,
    "field-bias": sensed.FieldBias,
    "ball-position": sensed.BallPosition,
    "artefact-expansion": sensed.ArtefactExpansion,
    "time-offset": transmission.TimeOffset,
    "reading-lag": transmission.ReadingLag,
    "noise-heteroscedastic": sensed.NoiseHeteroscedastic,
}
