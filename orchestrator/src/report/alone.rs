//! Plots as files of their own: one SVG with styles, the name that its page gives it, and the figure's legend.

use std::fmt::Write as _;

use super::{escape, samples};

/// Width of a file (px).
const WIDTH: f64 = 440.0;
/// Of a line of text, and about that of a letter (px).
const LINE: f64 = 17.0;
const LETTER: f64 = 6.2;
/// Of a legend's mark (px).
const MARK: f64 = 22.0;

/// A plot as a file of its own, with what it needs of styles, and of a legend that has entries; `None` for what moves.
#[must_use]
pub fn standalone(plot: &str, legend: &[(&str, String)]) -> Option<String> {
    if plot.contains("<script") {
        return None;
    }
    let start = plot.find("<svg")?;
    let svg = &plot[start..plot.rfind("</svg>")? + "</svg>".len()];
    let of = |name: &str| Some(svg.split_once(&format!(" {name}=\""))?.1.split_once('"')?.0);
    let sides: Vec<f64> = of("viewBox")?.split_whitespace().filter_map(|x| x.parse().ok()).collect();
    let [_, _, width, height] = sides[..] else { return None };

    let mut top = 0.0;
    let mut head = String::new();
    if let Some((_, heading)) = plot[..start].split_once("<h3>") {
        top += LINE;
        let _ = write!(
            head,
            "<text class=\"title\" x=\"4\" y=\"{:.0}\">{}</text>",
            top - 4.0,
            heading.split("</h3>").next()?
        );
    }
    let mut x = WIDTH;
    for (class, text) in legend {
        let needs = MARK + 6.0 + LETTER * text.chars().count() as f64 + 14.0;
        if x + needs > WIDTH {
            (x, top) = (4.0, top + LINE);
        }
        let y = top - 8.0;
        let _ = write!(
            head,
            "{}<text x=\"{:.0}\" y=\"{:.0}\">{}</text>",
            mark(class, x, y),
            x + MARK + 6.0,
            y + 4.0,
            escape(text)
        );
        x += needs;
    }
    if top > 0.0 {
        top += 4.0;
    }
    let tall = WIDTH * height / width;
    let [light, dark] = palettes();
    let rules: String = include_str!("figure.css").lines().skip(2).collect::<Vec<_>>().join("\n");
    Some(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {:.1}\" role=\"img\" aria-label=\"{}\">\
         <style>{}\n@media screen and (prefers-color-scheme: dark) {{\n{}\n}}</style>{}\
         <svg x=\"0\" y=\"{top}\" width=\"{WIDTH}\" height=\"{tall:.1}\"{}</svg>",
        top + tall,
        of("aria-label").unwrap_or_default(),
        resolved(&rules, &light),
        resolved(&rules, &dark),
        resolved(&head, &light),
        resolved(&samples::mixed(&svg["<svg".len()..], &light), &light)
    ))
}

/// A legend's mark, as the plots have it.
fn mark(class: &str, x: f64, y: f64) -> String {
    let (middle, end) = (x + 0.5 * MARK, x + MARK);
    match class {
        "speed" => format!(
            "<linearGradient id=\"speed\"><stop style=\"stop-color:var(--slow)\"/><stop offset=\"1\" \
             style=\"stop-color:var(--fast)\"/></linearGradient><rect x=\"{x:.0}\" y=\"{:.0}\" width=\"{MARK}\" \
             height=\"8\" fill=\"url(#speed)\"/>",
            y - 4.0
        ),
        "arrow" => format!(
            "<g class=\"panel\"><path d=\"M{x:.0} {y:.0}H{end:.0}\"/><polygon points=\"{:.0},{:.0} {:.0},{:.0} \
             {end:.0},{y:.0}\"/></g>",
            end - 7.0,
            y - 3.0,
            end - 7.0,
            y + 3.0
        ),
        "active" => format!("<path class=\"active\" d=\"M{x:.0} {y:.0}H{end:.0}\"/>"),
        dot if dot.starts_with("dot") => {
            format!("<circle class=\"{dot}\" cx=\"{middle:.0}\" cy=\"{y:.0}\" r=\"4\"/>")
        }
        line => format!("<path class=\"line {line}\" d=\"M{x:.0} {y:.0}H{end:.0}\"/>"),
    }
}

/// Names and values of the colours, light and dark: the first two lines of the style.
fn palettes() -> [Vec<(&'static str, &'static str)>; 2] {
    let mut lines = include_str!("figure.css").lines();
    std::array::from_fn(|_| {
        let line = lines.next().unwrap_or_default();
        line.split("--").skip(1).filter_map(|c| c.split(';').next()?.split_once(": ")).collect()
    })
}

/// A style without variables, which few programs but browsers know.
fn resolved(style: &str, palette: &[(&str, &str)]) -> String {
    palette.iter().fold(style.to_owned(), |s, (name, value)| s.replace(&format!("var(--{name})"), value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot() -> String {
        format!(
            "<h3>the body</h3><svg class=\"b\" viewBox=\"0 0 20 10\" aria-label=\"it\"><path style=\"{}\"/></svg>",
            samples::colour(0.25)
        )
    }

    /// What other programs than browsers draw, too: no variables, colours by number, in both themes' palettes.
    #[test]
    fn a_figure_of_its_own_has_no_variables() {
        let alone = standalone(&plot(), &[("speed", "speed".into())]).unwrap();
        assert!(!alone.contains("var(") && !alone.contains("color-mix"), "{alone}");
        // Halfway from #e7e3d9 to #b3202c
        assert!(alone.contains("style=\"fill:#cd8283\""), "{alone}");
        assert!(alone.contains("stroke: #c2410c") && alone.contains("stroke: #fb8c45"), "{alone}");
    }

    /// Heading and legend stand above the plot, in as many lines as they need; without them the plot is at the top.
    #[test]
    fn heading_and_legend_stand_above_the_plot() {
        let entries: Vec<(&str, String)> =
            (0..4).map(|i| ("initial", format!("entry {i} & more text"))).collect();
        let alone = standalone(&plot(), &entries).unwrap();
        assert!(alone.contains(">the body</text>") && alone.contains("entry 3 &amp; more text"), "{alone}");
        // A line of heading, two of legend
        assert!(alone.contains("<svg x=\"0\" y=\"55\" width=\"440\" height=\"220.0\""), "{alone}");
        assert!(alone.contains("viewBox=\"0 0 440 275.0\""), "{alone}");
        let bare = standalone(plot().split_once("</h3>").unwrap().1, &[]).unwrap();
        assert!(bare.contains("<svg x=\"0\" y=\"0\""), "{bare}");
    }
}
