# Print an optspec for argparse to handle cmd's options that are independent of any subcommand.
function __fish_vpcctl_global_optspecs
    string join \n domain= h/help V/version
end

function __fish_vpcctl_needs_command
    # Figure out if the current invocation already has a command.
    set -l cmd (commandline -opc)
    set -e cmd[1]
    argparse -s (__fish_vpcctl_global_optspecs) -- $cmd 2>/dev/null
    or return
    if set -q argv[1]
        # Also print the command, so this can be used to figure out what it is.
        echo $argv[1]
        return 1
    end
    return 0
end

function __fish_vpcctl_using_subcommand
    set -l cmd (__fish_vpcctl_needs_command)
    test -z "$cmd"
    and return 1
    contains -- $cmd[1] $argv
end

complete -c vpcctl -n "__fish_vpcctl_needs_command" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_needs_command" -s h -l help -d 'Print help (see more with \'--help\')'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -s V -l version -d 'Print version'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "status" -d 'Tell on one screen what the daemon does'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "watch" -d 'Show live what the daemon does: image plane, twist, times, states; keys command it'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "arm" -d 'Let the law move the camera'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "disarm" -d 'Brake to zero and stay there until the next arm'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "stop" -d 'Zero at once, without braking, and stay there until the next arm. Needs no observer\'s place'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "strategy" -d 'Change the strategy of the law'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "flight" -d 'Have the daemon write out its flight record'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "doctor" -d 'Say what is wrong with this machine or set-up, and how to mend it'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "metrics" -d 'Metrics in the Prometheus text format, served or printed'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "serve" -d 'Serve a live view for the browser, on loopback'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "completions" -d 'Print the completions for a shell'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "man" -d 'Write the man pages into a directory'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "record" -d 'Record what the domain says, for Foxglove, the mcap tools, plot and replay'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "plot" -d 'Draw a recording: paths, commands, latencies; and report deadlines'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "replay" -d 'Run the law again on a recording and compare'
complete -c vpcctl -n "__fish_vpcctl_needs_command" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand status" -l watch -d 'How long to watch the cycles, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand status" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand status" -l json -d 'JSON instead of text; numbers that are not known are null'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand status" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand watch" -l scene -d 'Scene file: image size, goal, occlusions and limits to draw' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand watch" -l neighbours -d 'Neighbours that the key 2 asks for, 1 to 64' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand watch" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand watch" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand arm" -l timeout -d 'How long to wait for the answer, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand arm" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand arm" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand disarm" -l timeout -d 'How long to wait for the answer, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand disarm" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand disarm" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand stop" -l timeout -d 'How long to wait for the answer, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand stop" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand stop" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand strategy" -l neighbours -d 'Neighbours averaged by knn, 1 to 64' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand strategy" -l timeout -d 'How long to wait for the answer, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand strategy" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand strategy" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand flight" -l timeout -d 'How long to wait for the answer, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand flight" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand flight" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand doctor" -l scene -d 'A scene file to check' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand doctor" -l memory -d 'A memory of motion to check, against the scene if there is one' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand doctor" -l watch -d 'How long to watch a running daemon, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand doctor" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand doctor" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand metrics" -l listen -d 'Address to serve at, path /metrics; port 0 takes a free one' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand metrics" -l watch -d 'How long to watch with --once, 0.05 to 3600 s' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand metrics" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand metrics" -l expose -d 'Allow an address that other machines reach. There is no encryption and no password'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand metrics" -l once -d 'Watch for a while, print, and exit'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand metrics" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand serve" -l scene -d 'Scene file: image size, goal, occlusions and limits to draw' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand serve" -l listen -d 'Address to serve at; port 0 takes a free one' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand serve" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand serve" -l expose -d 'Allow an address that other machines reach, for watching. There is no encryption and no password'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand serve" -l control -d 'Let the page arm, disarm and stop; for who has the address with its token, as it is printed'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand serve" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand completions" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand completions" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand man" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand man" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand record" -l scene -d 'Scene file: drawn, and kept in the recording' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand record" -l config -d 'The daemon\'s configuration: kept in the recording, and its scene where --scene is not given' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand record" -l duration -d 'End after this time, 0.05 to 86400 s; without it by SIGINT (Ctrl-C) or SIGTERM' -r
complete -c vpcctl -n "__fish_vpcctl_using_subcommand record" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand record" -l force -d 'Overwrite the file'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand record" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand plot" -s o -l output -d 'Directory for the figures (SVG and PNG) and the report; without it the report only, on standard output' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand plot" -l scene -d 'Scene file, instead of the one in the recording' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand plot" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand plot" -l json -d 'The report as JSON instead of text'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand plot" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand replay" -l domain -d 'Directory of the daemon\'s shared-memory domain. [default: /tmp/vpc-UID]' -r -F
complete -c vpcctl -n "__fish_vpcctl_using_subcommand replay" -s h -l help -d 'Print help'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "status" -d 'Tell on one screen what the daemon does'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "watch" -d 'Show live what the daemon does: image plane, twist, times, states; keys command it'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "arm" -d 'Let the law move the camera'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "disarm" -d 'Brake to zero and stay there until the next arm'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "stop" -d 'Zero at once, without braking, and stay there until the next arm. Needs no observer\'s place'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "strategy" -d 'Change the strategy of the law'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "flight" -d 'Have the daemon write out its flight record'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "doctor" -d 'Say what is wrong with this machine or set-up, and how to mend it'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "metrics" -d 'Metrics in the Prometheus text format, served or printed'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "serve" -d 'Serve a live view for the browser, on loopback'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "completions" -d 'Print the completions for a shell'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "man" -d 'Write the man pages into a directory'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "record" -d 'Record what the domain says, for Foxglove, the mcap tools, plot and replay'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "plot" -d 'Draw a recording: paths, commands, latencies; and report deadlines'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "replay" -d 'Run the law again on a recording and compare'
complete -c vpcctl -n "__fish_vpcctl_using_subcommand help; and not __fish_seen_subcommand_from status watch arm disarm stop strategy flight doctor metrics serve completions man record plot replay help" -f -a "help" -d 'Print this message or the help of the given subcommand(s)'
