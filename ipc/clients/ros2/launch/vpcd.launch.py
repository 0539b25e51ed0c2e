"""Starts vpcd and vpc-ros2 from ROS 2:

    ros2 launch ./vpcd.launch.py vpcd_config:=vpcd.toml gateway_config:=vpc-ros2.toml

ROS_DOMAIN_ID is handed over. Both programs end with the launch, however it ends. vpcd starts disarmed:
ros2 service call /vpcd/arm std_srvs/srv/Trigger"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import EnvironmentVariable, LaunchConfiguration


def generate_launch_description():
    domain = ["--domain", LaunchConfiguration("domain")]
    number = ["--ros-domain-id", EnvironmentVariable("ROS_DOMAIN_ID", default_value="0")]

    def started(program, configuration, *more):
        # A SIGTERM ends ros2 launch itself and leaves its processes running: the kernel then ends them.
        bound = ["setpriv", "--pdeathsig", "TERM"]
        words = ["--config", LaunchConfiguration(configuration), *domain, *more]
        return ExecuteProcess(cmd=[*bound, program, *words], name=program, output="screen")

    return LaunchDescription(
        [
            DeclareLaunchArgument("vpcd_config", default_value="/etc/vpcd/vpcd.toml"),
            DeclareLaunchArgument("gateway_config", default_value="/etc/vpcd/vpc-ros2.toml"),
            DeclareLaunchArgument("domain", description="directory of the shared memory, the same for all programs"),
            started("vpcd", "vpcd_config"),
            started("vpc-ros2", "gateway_config", *number),
        ]
    )
