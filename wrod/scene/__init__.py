"""The scene for review: a USD stage of a deployment, and pictures of it without a viewer.

phases          rod and arm over time codes
stage           units, time, lights, cameras
primitives      shapes, curves and materials on a stage
arm, workplace  the robot; table, floor, pattern, rod
export          all of it: `export_usd`
validate        OpenUSD's own checks
newton_model    a stage as a Newton model, for rendering and viewers
render          headless pictures
"""
