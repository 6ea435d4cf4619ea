"""A ROS 2 node that sends a joint path that `wrod plan --export ros-yaml` wrote.

    python send_joint_path_ros2.py out/trajectory_msgs.yaml /joint_trajectory_controller

It needs a ROS 2 installation (rclpy, control_msgs, trajectory_msgs) and a running controller. Bring
the arm near the first point first: the node refuses to start farther than 0.1 rad from it.
"""

import sys

import yaml

NEAR = 0.1  # [rad]


def read_trajectory(path):
    """`trajectory_msgs/JointTrajectory` as plain values; checks its shape."""
    with open(path, encoding="utf-8") as file:
        message = yaml.safe_load(file)
    count = len(message["joint_names"])
    for number, point in enumerate(message["points"]):
        for name in ("positions", "velocities", "accelerations"):
            if len(point[name]) != count:
                raise ValueError(f"{path}: point {number} has {len(point[name])} {name}")
    return message


def send():
    import rclpy
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    message = read_trajectory(sys.argv[1])
    controller = sys.argv[2] if len(sys.argv) > 2 else "/joint_trajectory_controller"
    rclpy.init()
    node = rclpy.create_node("wrod_joint_path")
    state = {}
    node.create_subscription(
        JointState,
        "/joint_states",
        lambda m: state.update(zip(m.name, m.position, strict=True)),
        10,
    )
    names = message["joint_names"]
    while rclpy.ok() and not set(names) <= set(state):
        rclpy.spin_once(node)
    first = dict(zip(names, message["points"][0]["positions"], strict=True))
    apart = max(abs(state[name] - first[name]) for name in names)
    if apart > NEAR:
        raise SystemExit(f"the arm is {apart:.2f} rad from the start; bring it there first")
    trajectory = JointTrajectory(joint_names=names)
    for point in message["points"]:
        trajectory.points.append(
            JointTrajectoryPoint(
                positions=point["positions"],
                velocities=point["velocities"],
                accelerations=point["accelerations"],
                time_from_start=Duration(**point["time_from_start"]),
            )
        )
    client = ActionClient(node, FollowJointTrajectory, f"{controller}/follow_joint_trajectory")
    client.wait_for_server()
    sent = client.send_goal_async(FollowJointTrajectory.Goal(trajectory=trajectory))
    rclpy.spin_until_future_complete(node, sent)
    done = sent.result().get_result_async()
    rclpy.spin_until_future_complete(node, done)
    node.get_logger().info(f"finished: {done.result().result.error_string or 'in order'}")
    rclpy.shutdown()


if __name__ == "__main__":
    send()
