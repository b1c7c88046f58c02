"""The catalogue of a scanner's physical effects: a name of the vocabulary a line."""

from sensors.effects import artefact, laser, optics, recorded, surface

CATALOGUE = {
    "lens-residual": optics.LensResidual,
    "window-refraction": optics.WindowRefraction,
    "focus-breathing": optics.FocusBreathing,
    "blooming": optics.Blooming,
    "camera-thermal-drift": optics.CameraThermalDrift,
    "board-bow": artefact.BoardBow,
    "artefact-expansion": artefact.ArtefactExpansion,
    "plane-bow": laser.PlaneBow,
    "ghost-line": laser.GhostLine,
    "incidence-bias": surface.IncidenceBias,
    "rolling-shutter": recorded.RollingShutter,
    "laser-drift": recorded.LaserDrift,
    "mirror-vibration": recorded.MirrorVibration,
    "recorded-column": recorded.RecordedColumn,
    "range-scale": surface.RangeScale,
    "lateral-scale": surface.LateralScale,
    "field-bias": surface.FieldBias,
    "subsurface-scatter": surface.SubsurfaceScatter,
    "board-point-errors": recorded.BoardPointErrors,
    "ball-position": artefact.BallPosition,
    "ball-radius": artefact.BallRadius,
    "ball-form": artefact.BallForm,
    "mirror-wobble": laser.MirrorWobble,
    "mirror-encoder-harmonic": laser.MirrorEncoderHarmonic,
    "mirror-hysteresis": laser.MirrorHysteresis,
    "frame-sync": laser.FrameSync,
    "noise-heteroscedastic": surface.NoiseHeteroscedastic,
}
