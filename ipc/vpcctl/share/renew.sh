#!/bin/bash
# Writes man pages and completions anew from the command line's description; a test says when that is due.
set -eu
cd "$(dirname "$0")"
run() { cargo run --quiet --package vpcctl -- "$@"; }
rm -f -- *.1
run man .
run completions bash > vpcctl.bash
run completions zsh > _vpcctl
run completions fish > vpcctl.fish
