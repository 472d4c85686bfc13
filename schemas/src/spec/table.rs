//! How a CSV is written, where its reader cannot tell.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What separates the fields of a CSV.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Separator {
    /// Commas.
    #[serde(rename = ",")]
    Comma,
    /// Semicolons.
    #[serde(rename = ";")]
    Semicolon,
    /// Tabs.
    #[serde(rename = "tab", alias = "\t")]
    Tab,
}

/// The decimal mark of a CSV.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum Decimal {
    /// A point.
    #[serde(rename = ".")]
    Point,
    /// A comma.
    #[serde(rename = ",")]
    Comma,
}
