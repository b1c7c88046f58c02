"""The catalogue of a scanner's physical effects: a name of the vocabulary a line."""

from sensors.effects import artefact, laser, optics, surface

CATALOGUE = {
    "lens-residual": optics.LensResidual,
    "camera-thermal-drift": optics.CameraThermalDrift,
    "window-refraction": optics.WindowRefraction,
    "plane-bow": laser.PlaneBow,
    "mirror-wobble": laser.MirrorWobble,
    "mirror-encoder-harmonic": laser.MirrorEncoderHarmonic,
    "mirror-hysteresis": laser.MirrorHysteresis,
    "frame-sync": laser.FrameSync,
    "range-scale": surface.RangeScale,
    "field-bias": surface.FieldBias,
    "incidence-bias": surface.IncidenceBias,
    "subsurface-scatter": surface.SubsurfaceScatter,
    "board-bow": artefact.BoardBow,
    "ball-position": artefact.BallPosition,
    "ball-radius": artefact.BallRadius,
    "artefact-expansion": artefact.ArtefactExpansion,
    "noise-heteroscedastic": surface.NoiseHeteroscedastic,
}
