//! `bench`: how fast, in rows that can be compared over the years.

mod brain;
mod engine;
mod implicit;
mod merge;
mod projection;
mod protocols;
mod soak;

use clap::Subcommand;

use super::Error;
use crate::exit::Exit;

/// Measures.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    Brain(brain::Args),
    Engine(engine::Args),
    Implicit(implicit::Args),
    Merge(merge::Args),
    Projection(projection::Args),
    Protocols(protocols::Args),
}

pub async fn execute(args: Args) -> Result<Exit, Error> {
    match args.what {
        What::Brain(args) => brain::execute(&args),
        What::Engine(args) => engine::execute(args).await,
        What::Implicit(args) => implicit::execute(&args),
        What::Merge(args) => merge::execute(args).await,
        What::Projection(args) => projection::execute(&args),
        What::Protocols(args) => protocols::execute(&args),
    }
}
