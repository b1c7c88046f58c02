"""The catalogue of a robot's physical effects: a name of the vocabulary, or a variant of one, a line."""

from robot_model.effects import drift, elastic, sensed, tilt, transmission

CATALOGUE = {
    "transmission-harmonic": transmission.TransmissionHarmonic,
    "zero-offset": transmission.ConstantTerm,
    "backlash": transmission.Backlash,
    "zero-shift": transmission.ZeroShift,
    "joint-coupling": transmission.JointCoupling,
    "joint-thermal-drift": transmission.JointThermalDrift,
    "time-offset": transmission.TimeOffset,
    "reading-lag": transmission.ReadingLag,
    "joint-compliance": elastic.JointCompliance,
    "link-self-weight": elastic.LinkSelfWeight,
    "ye-compliance": elastic.YeCompliance,
    "link-compliance": elastic.LinkCompliance,
    "bearing-compliance": elastic.BearingCompliance,
    "pedestal-compliance": elastic.PedestalCompliance,
    "tool-deflection": elastic.ToolDeflection,
    "mount-tilt": elastic.MountTilt,
    "mount-tilt-torsion": elastic.MountTorsion,
    "first-moment": elastic.FirstMoment,
    "link-thermal-growth": drift.LinkThermalGrowth,
    "base-drift": drift.BaseDrift,
    "axis-run-out": drift.AxisRunOut,
    "measured-tilt": tilt.MeasuredTilt,
    "range-scale": sensed.RangeScale,
    "field-bias": sensed.FieldBias,
    "ball-position": sensed.BallPosition,
    "artefact-expansion": sensed.ArtefactExpansion,
    "noise-heteroscedastic": sensed.NoiseHeteroscedastic,
}
