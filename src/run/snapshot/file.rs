//! insta's file format: a YAML header between two lines `---`, then the contents. Keys in insta's order, ours under
//! `info`: it would lose any other when it accepts a file.

use std::fmt::Write;

/// One snapshot, of text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snap {
    pub source: String,
    pub description: String,
    pub expression: String,
    /// In the order of the file.
    pub info: Vec<(String, String)>,
    /// Without trailing white space.
    pub contents: String,
}

impl Snap {
    pub fn info(&self, key: &str) -> Option<&str> {
        self.info.iter().find(|(k, _)| k == key).map(|(_, v)| &v[..])
    }

    pub fn to_text(&self) -> String {
        let mut out = "---\n".to_string();
        for (key, value) in
            [("source", &self.source), ("description", &self.description), ("expression", &self.expression)]
        {
            if !value.is_empty() {
                writeln!(out, "{key}: {}", quoted(value)).expect("a string grows");
            }
        }
        if !self.info.is_empty() {
            out += "info:\n";
        }
        if out == "---\n" {
            out += "{}\n"; // insta refuses a header of nothing
        }
        for (key, value) in &self.info {
            // As insta would print the number that it reads; of -0 it makes 0.
            let number = value.parse().is_ok_and(|n: f64| n.is_finite() && n.to_string() == *value) && value != "-0";
            let value = if number { value.clone() } else { quoted(value) };
            writeln!(out, "  {key}: {value}").expect("a string grows");
        }
        out + "---\n" + lines_of(&self.contents).trim_end() + "\n"
    }

    /// Reads what [`Snap::to_text`] or insta wrote. What is not understood is left out: the file is only compared.
    pub fn parse(text: &str) -> Self {
        let text = lines_of(text);
        let mut out = Self::default();
        let ruler = |line: &str| line.trim_end() == "---";
        let Some(rest) = text.split_once('\n').filter(|(first, _)| ruler(first)).map(|(_, rest)| rest) else {
            return Self { contents: text.trim_end().to_string(), ..out };
        };
        let header: usize = rest.split_inclusive('\n').take_while(|line| !ruler(line)).map(str::len).sum();
        let (header, contents) = rest.split_at(header);
        out.contents = contents.split_once('\n').map_or("", |(_, contents)| contents).trim_end().to_string();
        for line in header.lines() {
            let Some((key, value)) = line.split_once(':') else { continue };
            let value = unquoted(value.trim_matches(' '));
            match key {
                "source" => out.source = value,
                "description" => out.description = value,
                "expression" => out.expression = value,
                _ => {
                    if let Some(key) = key.strip_prefix("  ").filter(|k| !k.starts_with([' ', '-'])) {
                        out.info.push((key.to_string(), value));
                    }
                }
            }
        }
        out
    }
}

/// Line ends as insta has them once it has read a file: a carriage return before one is no part of the line.
fn lines_of(text: &str) -> String {
    let mut text = text.to_string();
    while text.contains("\r\n") {
        text = text.replace("\r\n", "\n");
    }
    text
}

/// A YAML string as insta writes it: plain where nothing in it means something, else in double quotes.
fn quoted(text: &str) -> String {
    // In small letters, in capitals, or with one.
    let means = |word: &str| {
        let first = word[..1].to_uppercase() + &word[1..];
        text == word || text == word.to_uppercase() || text == first
    };
    let words = ["yes", "no", "true", "false", "on", "off", "null", "~"];
    // What insta escapes; the others it leaves as they are (bell, backspace, tab of lines, form feed, escape).
    let escaped = |c: char| matches!(c, '\0'..='\x06' | '\t' | '\n' | '\r' | '\x0e'..='\x1a' | '\x1c'..='\x1f');
    let plain = !text.is_empty()
        && !text.starts_with(' ')
        && !text.ends_with(' ')
        && text.parse::<f64>().is_err()
        && !text.starts_with(['&', '*', '?', '|', '-', '<', '>', '=', '!', '%', '@', '.'])
        && !text.starts_with("0x")
        && !is_octal(text)
        && !text.contains([':', '{', '}', '[', ']', ',', '#', '`', '"', '\'', '\\'])
        && !text.contains(escaped)
        && !words.iter().any(|w| means(w));
    if plain { text.to_string() } else { serde_json::Value::from(text).to_string().replace('\x7f', "\\u007f") }
}

/// `0o17`: insta writes such a word without quotes, and reads a number back.
fn is_octal(text: &str) -> bool {
    text.strip_prefix("0o").is_some_and(|rest| i64::from_str_radix(rest, 8).is_ok())
}

fn unquoted(value: &str) -> String {
    let text = value.starts_with('"').then(|| serde_json::from_str(value).ok()).flatten();
    text.unwrap_or_else(|| value.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn through_insta(snap: &Snap) -> (insta::Snapshot, String) {
        let folder = tempfile::tempdir().unwrap();
        let [ours, theirs] = ["ours.snap", "theirs.snap"].map(|n| folder.path().join(n));
        std::fs::write(&ours, snap.to_text()).unwrap();
        let read = insta::Snapshot::from_file(&ours).unwrap();
        read.save(&theirs).unwrap();
        (read, std::fs::read_to_string(theirs).unwrap())
    }

    #[test]
    fn a_file_of_ours() {
        let snap = Snap {
            source: "town.toml".into(),
            description: "Hulls by cut".into(),
            expression: "lodge show town.toml cut[n=3]".into(),
            info: vec![("digest".into(), "12e4".into()), ("absolute".into(), 1e-6.to_string())],
            contents: "Hulls\nclusters: 3".into(),
        };
        let text = "---\nsource: town.toml\ndescription: Hulls by cut\nexpression: \"lodge show town.toml cut[n=3]\"\n\
                    info:\n  digest: \"12e4\"\n  absolute: 0.000001\n---\nHulls\nclusters: 3\n";
        assert_eq!(snap.to_text(), text);
        assert_eq!(Snap::parse(text), snap);
        assert_eq!(Snap::parse(&text.replace('\n', "\r\n")), snap);
        assert_eq!(through_insta(&snap).1, text);
        for odd in ["", "---", "---\n---\n", "no header\n", "---\nsource", "---\ninfo:\n  a\n---\n"] {
            Snap::parse(odd);
        }
    }

    /// The same numbers each time (splitmix64).
    struct Dice(u64);

    impl Dice {
        fn below(&mut self, n: usize) -> usize {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = self.0;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) % n as u64) as usize
        }

        fn one_of<T: Copy>(&mut self, all: &[T]) -> T {
            all[self.below(all.len())]
        }

        fn char(&mut self) -> char {
            match self.below(8) {
                0 => self.one_of(&[':', '#', '\'', '"', '\\', '-', '?', '|', '{', ']', ',', '%', '@', '`', '~', '=']),
                1 => self.one_of(&[' ', ' ', '\t', '\u{a0}', '\u{2003}', '\u{3000}', '\u{85}', '\u{2028}']),
                2 => self.one_of(&[
                    'é',
                    'ß',
                    '東',
                    '\u{301}',
                    '🏠',
                    '\u{200b}',
                    '\u{feff}',
                    '\u{10ffff}',
                    'א',
                    '\u{fffd}',
                ]),
                3 if self.below(4) == 0 => char::from(self.below(32) as u8),
                4 if self.below(8) == 0 => self.one_of(&['\x7f', '\u{80}', '\u{9f}', '\r']),
                5 => char::from(b'0' + self.below(10) as u8),
                _ => char::from(b'a' + self.below(26) as u8),
            }
        }

        fn chars(&mut self, most: usize) -> String {
            (0..self.below(most + 1)).map(|_| self.char()).collect()
        }

        fn word(&mut self) -> String {
            let words = [
                "",
                "~",
                "null",
                "Null",
                "nULL",
                "true",
                "No",
                "ON",
                "y",
                "---",
                "...",
                "-",
                "- a",
                "a: b",
                "a #b",
                "'a'",
                "\"a\"",
                "0x1f",
                "0o9",
                "1_000",
                "12e4",
                "1e400",
                "-0",
                "0",
                "-1",
                "+1",
                "1.",
                ".5",
                "NaN",
                ".nan",
                "inf",
                "-.inf",
                "9223372036854775807",
                "9223372036854775808",
                "00",
                "1.50",
                "0.000001",
                "2014-12-31",
                "%YAML",
                "<<",
                "=",
                "!tag",
                "&a",
                "*a",
                "|",
                ">-",
                "cut[n=3]",
                "a\r\nb",
                "a\n---\nb",
                "c:\\d",
            ];
            match self.below(6) {
                0 | 1 => self.one_of(&words).to_string(),
                2 => format!("{}", (self.below(2_000_001) as f64 - 1e6) / self.one_of(&[1.0, 7.0, 1e3, 1e12])),
                3 => self.chars(2000),
                _ => self.chars(12),
            }
        }

        fn contents(&mut self) -> String {
            let mut out = String::new();
            for _ in 0..self.below(12) {
                out += &match self.below(8) {
                    0 => self.word(),
                    1 => "---".to_string(),
                    2 => self.one_of(&["", "  ", "\t", "--- ", "info:", "  key: \"", "\u{feff}"]).to_string(),
                    3 => "x".repeat(self.below(6000)),
                    _ => self.chars(80),
                };
                out += self.one_of(&["\n", "\n", "\n", "\n\n", " \n", "\r\n", "\r\r\n", "\r"]);
            }
            out
        }

        fn snap(&mut self) -> Snap {
            let mut maybe = |all: usize| if self.below(all) == 0 { String::new() } else { self.word() };
            let [source, description, expression] = [maybe(4), maybe(4), maybe(4)];
            let keys = ["node", "op", "version", "digest", "absolute", "relative"];
            let info = keys[..self.one_of(&[0, 1, 6, 6])].iter().map(|k| (k.to_string(), self.word())).collect();
            Snap { source, description, expression, info, contents: self.contents() }
        }
    }

    /// What insta holds under `info`, as our words: its numbers as it prints them.
    fn info_of(read: &insta::Snapshot) -> Vec<(String, String)> {
        use insta::internals::Content;
        let Some(Content::Map(all)) = read.metadata().private_info() else { return Vec::new() };
        let word = |value: &Content| match value {
            Content::String(s) => s.clone(),
            Content::I64(n) => n.to_string(),
            Content::F64(n) => n.to_string(),
            other => panic!("{other:?} is neither a text nor a number"),
        };
        all.iter().map(|(k, v)| (k.as_str().unwrap().to_string(), word(v))).collect()
    }

    // What we write, insta reads; what it writes of that, is our bytes, and we read it; what it holds equal, we do.
    #[test]
    fn a_thousand_snapshots_go_through_insta_and_come_back_the_same() {
        let mut dice = Dice(8);
        for k in 0..1000 {
            let snap = dice.snap();
            let ours = snap.to_text();
            let (read, theirs) = through_insta(&snap);
            assert_eq!(theirs, ours, "{k}: {snap:?}");
            let meta = read.metadata();
            let told = [meta.source(), meta.description(), meta.expression()].map(Option::unwrap_or_default);
            assert_eq!(told, [&snap.source, &snap.description, &snap.expression], "{k}");
            assert_eq!(info_of(&read), snap.info, "{k}");
            let contents = lines_of(&snap.contents).trim_end().to_string();
            assert_eq!(read.as_text().unwrap().to_string(), contents, "{k}");
            // Read again, and with line ends of another system.
            let again = Snap { contents, ..snap };
            assert_eq!(Snap::parse(&theirs), again, "{k}");
            assert_eq!(Snap::parse(&theirs.replace('\n', "\r\n")), again, "{k}");

            // insta's opinion of two texts, the second one a little changed.
            let mut changed = again.clone();
            changed.contents += dice.one_of(&["\n", " \t\n\r\n", "x", "\u{2003}", "\n."]);
            if dice.below(2) == 0 {
                changed.contents = changed.contents.replace('\n', "\r\n");
            }
            let equal = read.contents() == through_insta(&changed).0.contents();
            assert_eq!(
                Snap::parse(&changed.to_text()).contents == again.contents,
                equal,
                "{k}: {:?}",
                changed.contents
            );
            if equal {
                assert!(super::super::text::same(&again.contents, &changed.contents, 0.0, 0.0), "{k}");
            }
        }
    }

    // The one word of which insta makes another: ours stays a text when it reads it.
    #[test]
    fn octal_words_are_in_quotes() {
        let snap = Snap { description: "0o17".into(), ..Snap::default() };
        assert_eq!(snap.to_text(), "---\ndescription: \"0o17\"\n---\n\n");
        assert_eq!(through_insta(&snap).0.metadata().description(), Some("0o17"));
        assert_eq!(Snap::parse("---\ndescription: 0o17\n---\n").description, "0o17");
    }

    // Files that insta wrote itself, of the tests beside ours.
    #[test]
    fn files_of_insta_are_read() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/diagnostics");
        let mut all = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_none_or(|e| e != "snap") {
                continue;
            }
            let (ours, theirs) =
                (Snap::parse(&std::fs::read_to_string(&path).unwrap()), insta::Snapshot::from_file(&path).unwrap());
            assert_eq!(ours.source, theirs.metadata().source().unwrap_or_default(), "{}", path.display());
            assert_eq!(ours.expression, theirs.metadata().expression().unwrap_or_default(), "{}", path.display());
            assert_eq!(ours.description, theirs.metadata().description().unwrap_or_default(), "{}", path.display());
            assert_eq!(ours.contents, theirs.as_text().unwrap().to_string(), "{}", path.display());
            all += 1;
        }
        assert!(all > 20, "{all}");
    }
}
