//! What users do with the program, and what may befall it: one binary, so that tests that wait and tests that compute share
//! the machine, and the program is linked once.

mod common;
mod synthetic;

mod answers;
mod bad_input;
mod bodies;
mod brains;
mod browser;
mod casts;
mod comparison;
mod control;
mod design;
mod evaluate;
mod expand;
mod exports;
mod extremes;
mod foreign;
mod goal;
mod hyperqueue;
mod identify;
mod measured;
mod merge;
mod names;
mod physics;
mod provenance;
mod query;
mod references;
mod run;
mod serve;
mod shards;
mod simulate;
mod slurm;
mod spec_fuzz;
mod ssh;
mod store;
mod submit;
mod training;
mod transfer;
mod twin;
mod until;
mod upgrade;
