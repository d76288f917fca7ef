//! Diagnostics as people read them (source line, caret, help) and as JSON. The only file that knows annotate-snippets.

use std::borrow::Cow;
use std::sync::Arc;

use annotate_snippets::renderer::DecorStyle;
use annotate_snippets::{AnnotationKind, Group, Level, Renderer, Snippet};
use serde_json::{Value, json};

use crate::diag::{Diagnostic, Severity, SourceFile, Span};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// No colours: files, pipes, snapshots.
    Plain,
    Colour,
}

impl Style {
    pub fn for_stderr() -> Self {
        use std::io::IsTerminal;
        let plain = std::env::var_os("NO_COLOR").is_some_and(|v| !v.is_empty());
        if !plain && std::io::stderr().is_terminal() { Style::Colour } else { Style::Plain }
    }
}

/// All of them, an empty line after each.
pub fn text(diagnostics: &[Box<Diagnostic>], style: Style) -> String {
    let mut lines = Lines::default();
    diagnostics.iter().map(|d| one_of(d, style, &mut lines) + "\n").collect()
}

/// One diagnostic with its source line and caret; ends with a newline.
pub fn one(diagnostic: &Diagnostic, style: Style) -> String {
    one_of(diagnostic, style, &mut Lines::default())
}

fn one_of(diagnostic: &Diagnostic, style: Style, lines: &mut Lines) -> String {
    let level = match diagnostic.severity {
        Severity::Error => Level::ERROR,
        Severity::Warning => Level::WARNING,
    };
    let message = match &diagnostic.node {
        Some(node) => format!("node `{node}`: {}", diagnostic.message),
        None => diagnostic.message.clone(),
    };
    let mut group = Group::with_title(level.primary_title(one_line(&message)).id(diagnostic.code));
    if let Some(span) = &diagnostic.span {
        let place = Place::of(span, lines);
        let (from, to) = place.on_first_line();
        let snippet = Snippet::source(place.source.to_string())
            .line_start(place.line)
            .path(span.file.name.clone())
            .annotation(AnnotationKind::Primary.span(from..to));
        group = group.element(snippet);
    }
    if let Some(help) = &diagnostic.suggestion {
        group = group.element(Level::HELP.message(one_line(help)));
    }
    let renderer = match style {
        Style::Plain => Renderer::plain(),
        Style::Colour => Renderer::styled().decor_style(DecorStyle::Unicode),
    };
    renderer.render(&[group]) + "\n"
}

/// What stands in `diagnostics` of every `--json`; `null` where there is nothing to say. Lines and columns count
/// from one, columns in characters; the end is behind the last character.
pub fn json(diagnostic: &Diagnostic) -> Value {
    json_of(diagnostic, &mut Lines::default())
}

fn json_of(diagnostic: &Diagnostic, lines: &mut Lines) -> Value {
    let place = diagnostic.span.as_ref().map(|span| Place::of(span, lines));
    let at = |f: fn(&Place) -> usize| place.as_ref().map(f);
    json!({
        "code": diagnostic.code,
        "severity": diagnostic.severity,
        "message": shortened(&diagnostic.message),
        "file": diagnostic.span.as_ref().map(|s| &s.file.name),
        "line": at(|p| p.line),
        "column": at(|p| p.column),
        "end-line": at(|p| p.end_line),
        "end-column": at(|p| p.end_column),
        "node": diagnostic.node,
        "value": diagnostic.value,
        "suggestion": diagnostic.suggestion,
    })
}

pub fn all_json(diagnostics: &[Box<Diagnostic>]) -> Value {
    let mut lines = Lines::default();
    diagnostics.iter().map(|d| json_of(d, &mut lines)).collect()
}

/// Where the lines of the texts begin: ten thousand mistakes of one file look for them once.
#[derive(Default)]
struct Lines(Vec<(Arc<SourceFile>, Vec<usize>)>);

impl Lines {
    /// Number (from one) of the line that holds byte `at`, and where it begins; a byte-order mark is no column.
    fn at(&mut self, file: &Arc<SourceFile>, at: usize) -> (usize, usize) {
        let known = self.0.iter().position(|(f, _)| Arc::ptr_eq(f, file)).unwrap_or_else(|| {
            let breaks = file.text.match_indices('\n').map(|(i, _)| i + 1);
            self.0.push((file.clone(), std::iter::once(0).chain(breaks).collect()));
            self.0.len() - 1
        });
        let starts = &self.0[known].1;
        let line = starts.partition_point(|&start| start <= at);
        let begin = starts[line - 1];
        let mark = begin == 0 && at >= 3 && file.text.starts_with('\u{feff}');
        (line, if mark { 3 } else { begin })
    }
}

/// A span in lines and columns, with its first line.
struct Place<'a> {
    line: usize,
    column: usize,
    end_line: usize,
    end_column: usize,
    source: &'a str,
    /// Bytes within `source`.
    from: usize,
    to: usize,
}

impl<'a> Place<'a> {
    fn of(span: &'a Span, lines: &mut Lines) -> Self {
        let text = span.file.text.as_str();
        let start = text.floor_char_boundary(span.range.start.min(text.len()));
        let end = text.floor_char_boundary(span.range.end.clamp(start, text.len()));
        let (line, begin) = lines.at(&span.file, start);
        let (end_line, end_begin) = lines.at(&span.file, end);
        let stop = text[begin..].find('\n').map_or(text.len(), |i| begin + i);
        let source = text[begin..stop].trim_end_matches('\r');
        Self {
            line,
            column: text[begin..start].chars().count() + 1,
            end_line,
            end_column: text[end_begin..end].chars().count() + 1,
            source,
            from: (start - begin).min(source.len()),
            to: (end - begin).min(source.len()),
        }
    }

    /// Where the caret goes: never empty, within the first line.
    fn on_first_line(&self) -> (usize, usize) {
        (self.from, self.to.max(self.from))
    }
}

/// Messages are one line: what a user wrote may hold line breaks and control characters.
fn one_line(text: &str) -> String {
    let text = shortened(text);
    text.chars().flat_map(|c| if c.is_control() { c.escape_default().collect::<Vec<_>>() } else { vec![c] }).collect()
}

/// A name or path of a thousand characters says nothing that its ends do not.
fn shortened(text: &str) -> Cow<'_, str> {
    if text.len() <= MOST_WORD || text.split(' ').all(|word| word.len() <= MOST_WORD) {
        return text.into();
    }
    let short = |word: &str| {
        if word.len() <= MOST_WORD {
            return word.to_string();
        }
        let (from, to) = (word.floor_char_boundary(MOST_WORD / 2), word.ceil_char_boundary(word.len() - MOST_WORD / 4));
        format!("{}...{}", &word[..from], &word[to..])
    };
    text.split(' ').map(short).collect::<Vec<_>>().join(" ").into()
}

const MOST_WORD: usize = 300;

#[cfg(test)]
mod tests {
    use super::*;

    fn span(text: &str, range: std::ops::Range<usize>) -> Span {
        let file = SourceFile { name: "a.toml".into(), path: "a.toml".into(), text: text.into() };
        Span { file: Arc::new(file), range }
    }

    #[test]
    fn caret_line_and_column() {
        let d = Diagnostic::error("out-of-range", "`keep` must be at least 0.01, got 0")
            .at(span("a = 1\r\nkeep = 0\r\n", 14..15))
            .node("hulls")
            .help("try 0.5");
        let text = one(&d, Style::Plain);
        assert!(text.contains("error[out-of-range]: node `hulls`: `keep` must be at least 0.01, got 0"), "{text}");
        assert!(text.contains("a.toml:2:8"), "{text}");
        assert!(text.contains("2 | keep = 0\n"), "{text}");
        assert!(text.contains("= help: try 0.5"), "{text}");
        let json = json(&d);
        assert_eq!((&json["line"], &json["column"], &json["end-column"]), (&2.into(), &8.into(), &9.into()));
    }

    #[test]
    fn endless_names_show_their_ends() {
        let d = Diagnostic::error("x", format!("there is no operator `{}b`", "aä".repeat(50_000)));
        let text = one(&d, Style::Plain);
        assert!(
            text.len() < 400 && text.contains("`aäaä") && text.contains("...") && text.ends_with("aäb`\n"),
            "{text}"
        );
        assert!(json(&d)["message"].as_str().unwrap().len() < 400);
        assert_eq!(shortened(&"words of a long list ".repeat(100)), "words of a long list ".repeat(100));
    }

    #[test]
    fn any_span_of_any_text_has_a_place() {
        for text in ["", "\u{feff}ä = 1\r\n\r\nö", "\n\n", "\ta\tb"] {
            for start in 0..text.len() + 3 {
                for end in 0..text.len() + 3 {
                    let d = Diagnostic::error("x", "y\nz").at(Span { range: start..end, ..span(text, 0..0) });
                    one(&d, Style::Plain);
                    json(&d);
                }
            }
        }
        let d = Diagnostic::error("x", "y").at(span("\u{feff}ä = 1", 5..6));
        assert_eq!(json(&d)["column"], 2);
    }
}
