//! The SVG elements of charts. Errors of `write!` are ignored, as writing to a `String` cannot fail.

use std::fmt::Write;

/// Alignment of a text: which part of it is at its coordinates.
#[derive(Debug, Clone, Copy, strum::AsRefStr)]
#[strum(serialize_all = "snake_case")]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// Writer of an SVG document; coordinates are pixels from the upper left corner.
#[derive(Debug)]
pub(super) struct Canvas {
    text: String,
}

impl Canvas {
    pub(super) fn new(width: f64, height: f64) -> Self {
        let text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             font-family=\"Helvetica, Arial, sans-serif\" fill=\"#222\">\n<rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>\n"
        );
        Self { text }
    }

    pub(super) fn text(&mut self, x: f64, y: f64, size: f64, anchor: Anchor, content: &str) {
        self.text_with(format_args!("x=\"{x:.1}\" y=\"{y:.1}\""), size, anchor, content);
    }

    /// A text with a white outline, which is readable over bars and lines.
    pub(super) fn outlined_text(&mut self, x: f64, y: f64, size: f64, anchor: Anchor, content: &str) {
        let outline = "stroke=\"#fff\" stroke-width=\"4\" stroke-linejoin=\"round\" paint-order=\"stroke\"";
        self.text_with(format_args!("x=\"{x:.1}\" y=\"{y:.1}\" {outline}"), size, anchor, content);
    }

    /// A text that is turned clockwise by `degrees` around (x, y), where its anchor is.
    pub(super) fn turned_text(&mut self, (x, y): (f64, f64), degrees: i32, size: f64, anchor: Anchor, content: &str) {
        let turn = format_args!("transform=\"translate({x:.1} {y:.1}) rotate({degrees})\"");
        self.text_with(turn, size, anchor, content);
    }

    fn text_with(&mut self, place: std::fmt::Arguments<'_>, size: f64, anchor: Anchor, content: &str) {
        let (anchor, content) = (anchor.as_ref(), escape(content));
        self.push(format_args!("<text {place} font-size=\"{size}\" text-anchor=\"{anchor}\">{content}</text>"));
    }

    pub(super) fn line(&mut self, from: (f64, f64), to: (f64, f64), colour: &str, width: f64, dashed: bool) {
        let dash = if dashed { " stroke-dasharray=\"6 4\"" } else { "" };
        self.push(format_args!(
            "<line x1=\"{:.1}\" y1=\"{:.1}\" x2=\"{:.1}\" y2=\"{:.1}\" stroke=\"{colour}\" stroke-width=\"{width}\"{dash}/>",
            from.0, from.1, to.0, to.1
        ));
    }

    pub(super) fn rectangle(&mut self, x: f64, y: f64, width: f64, height: f64, fill: &str) {
        self.push(format_args!(
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{fill}\"/>"
        ));
    }

    pub(super) fn circle(&mut self, x: f64, y: f64, radius: f64, fill: &str) {
        self.push(format_args!("<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{radius}\" fill=\"{fill}\"/>"));
    }

    /// A closed area in a transparent colour.
    pub(super) fn area(&mut self, corners: impl Iterator<Item = (f64, f64)>, colour: &str) {
        let list = places(corners);
        self.push(format_args!("<polygon points=\"{list}\" fill=\"{colour}\" fill-opacity=\"0.2\"/>"));
    }

    pub(super) fn polyline(&mut self, points: &[(f64, f64)], colour: &str) {
        let list = places(points.iter().copied());
        self.push(format_args!(
            "<polyline points=\"{list}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"1.8\" stroke-linejoin=\"round\"/>"
        ));
    }

    pub(super) fn finish(mut self) -> String {
        self.text.push_str("</svg>\n");
        self.text
    }

    fn push(&mut self, element: std::fmt::Arguments<'_>) {
        let _ = writeln!(self.text, "{element}");
    }
}

fn places(points: impl Iterator<Item = (f64, f64)>) -> String {
    let mut list = String::new();
    for (x, y) in points {
        let _ = write!(list, "{x:.1},{y:.1} ");
    }
    list.truncate(list.trim_end().len());
    list
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
