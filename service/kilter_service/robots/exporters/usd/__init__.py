"""A version as a stage of USD: an articulation of UsdPhysics whose joints are where they are and sag as they do."""
