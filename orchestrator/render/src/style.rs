//! Colours and styles: variables for pages, plain values for files, which not only browsers read.

/// Names and values of the colours, light and dark.
const PALETTE: [(&str, [&str; 2]); 16] = [
    ("ink", ["#1d2126", "#e8e6e1"]),
    ("soft", ["#5b626c", "#a3a9b3"]),
    ("line", ["#d9d5cb", "#3a4049"]),
    ("page", ["#fbfaf7", "#14161a"]),
    ("panel", ["#ffffff", "#1b1e24"]),
    ("initial", ["#66707d", "#9aa5b4"]),
    ("optimised", ["#c2410c", "#fb8c45"]),
    ("third", ["#0e7490", "#38bdd3"]),
    ("fourth", ["#a16207", "#dcb437"]),
    ("fifth", ["#3f7d20", "#86c95a"]),
    ("bad", ["#b91c1c", "#f87171"]),
    ("link", ["#0b63a5", "#7cb8f0"]),
    ("stone", ["#d8d3c6", "#4a505b"]),
    ("slow", ["#e7e3d9", "#2b3038"]),
    ("fast", ["#b3202c", "#ff6b5e"]),
    ("rule", ["#dcd8cf", "#353a43"]),
];

/// Classes of series of lines or dots; further series are thin.
pub const SERIES: [&str; 5] = ["truth", "optimised", "front", "fourth", "fifth"];

/// Steps of the colours from `slow` to `fast`: classes `s0` to `s20`.
pub const LEVELS: usize = 20;

/// The class for a fraction of the maximum, 0 to 1. The square root makes small values visible.
pub fn level(part: f64) -> String {
    format!("s{:.0}", LEVELS as f64 * part.clamp(0.0, 1.0).sqrt())
}

const FIGURES: &str = include_str!("figure.css");
const DARK: &str = "@media screen and (prefers-color-scheme: dark)";

/// The style of a page: both themes, with variables.
pub fn page_style() -> String {
    let variables = |theme: usize| -> String {
        let all = PALETTE.iter().map(|(name, values)| format!("--{name}: {}; ", values[theme]));
        format!(":root {{ {}}} {}", all.collect::<String>(), levels(theme))
    };
    // elements with a level are units too: the later rule wins
    let (light, dark) = (variables(0), variables(1));
    format!("{FIGURES}{light}\n{DARK} {{ {dark} }}\n{}", include_str!("page.css"))
}

/// The style of a file: both themes, with values.
pub(super) fn file_style() -> String {
    let rules = |theme: usize| -> String {
        let resolve = |css: String, (name, values): &(&str, [&str; 2])| {
            css.replace(&format!("var(--{name})"), values[theme])
        };
        PALETTE.iter().fold(FIGURES.to_owned(), resolve) + &levels(theme)
    };
    format!("{}\n{DARK} {{\n{}\n}}", rules(0), rules(1))
}

/// Rules for the colours from `slow` to `fast`, mixed in sRGB.
fn levels(theme: usize) -> String {
    let channels = |name: &str| -> [f64; 3] {
        let hex = PALETTE.iter().find(|(n, _)| *n == name).expect("a colour of the palette").1[theme];
        std::array::from_fn(|i| u8::from_str_radix(&hex[2 * i + 1..][..2], 16).expect("#rrggbb").into())
    };
    let (slow, fast) = (channels("slow"), channels("fast"));
    let rule = |i: usize| {
        let mixed = |c: usize| (slow[c] + i as f64 / LEVELS as f64 * (fast[c] - slow[c])).round() as u8;
        format!("svg .s{i} {{ fill: #{:02x}{:02x}{:02x}; }} ", mixed(0), mixed(1), mixed(2))
    };
    (0..=LEVELS).map(rule).collect()
}

#[cfg(test)]
mod tests;
