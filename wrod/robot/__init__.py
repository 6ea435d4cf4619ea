"""From a grip trajectory to a joint path of an arm.

urdf, mesh, model       the robot: a URDF, its shapes, limits and frames
kinematics              batched forward and inverse kinematics
grip                    how the rod is held, and the grip's path as a smooth curve
placement               where the pattern lies before the robot
search                  inverse kinematics branches, followed along the whole path
collision, redundancy   distances, and the freedom of the elbow spent on them
report                  what a path keeps and where it fails
timing                  jerk-limited run along the path (Ruckig)
solve, joint_path       all of it: `solve_joint_path`, `JointPath`
"""
