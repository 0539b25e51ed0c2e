"""Starts vpcd and vpc-ros2 from ROS 2:

    ros2 launch ./vpcd.launch.py vpcd_config:=vpcd.toml gateway_config:=vpc-ros2.toml

ROS_DOMAIN_ID is handed over. vpcd starts disarmed: ros2 service call /vpcd/arm std_srvs/srv/Trigger"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import EnvironmentVariable, LaunchConfiguration


def generate_launch_description():
    domain = ["--domain", LaunchConfiguration("domain")]
    number = ["--ros-domain-id", EnvironmentVariable("ROS_DOMAIN_ID", default_value="0")]
    return LaunchDescription(
        [
            DeclareLaunchArgument("vpcd_config", default_value="/etc/vpcd/vpcd.toml"),
            DeclareLaunchArgument("gateway_config", default_value="/etc/vpcd/vpc-ros2.toml"),
            DeclareLaunchArgument("domain", description="directory of the shared memory, the same for all programs"),
            ExecuteProcess(cmd=["vpcd", "--config", LaunchConfiguration("vpcd_config"), *domain], output="screen"),
            ExecuteProcess(
                cmd=["vpc-ros2", "--config", LaunchConfiguration("gateway_config"), *domain, *number], output="screen"
            ),
        ]
    )
