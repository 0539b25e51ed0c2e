//! Parts of a memory and of a table: by hand, under a real Slurm, and in a Job of Kubernetes, which is
//! only read.
//!
//! `cargo test --test cluster -- --include-ignored`; `VPC_LONG=1` for the sizes of `SCALING.md`.

mod kubernetes;
mod nodes;
mod slurm;
mod table;
